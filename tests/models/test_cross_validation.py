"""Cross-validation of rollouts: what is fitted and trained knows nothing of the drives that were left out."""

from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks.cross_validation import METHODS, Material, errors, folds, forecasters, joined, table
from envpred.errors import UserError
from envpred.models import CorrectedRolloutForecaster, RolloutForecaster
from envpred.store import Store
from tests.store.stores import write_store

OUT = ["c"]


def learned(folder: Path, frames: dict[str, int]) -> list[np.ndarray]:
    """All that is fitted and trained where OUT is left out, of drives of so many frames."""
    drives = {name: list(range(count)) for name, count in frames.items()}
    # At 20 Hz the ego's steps are those of somebody who drives.
    store = write_store(folder, drives, cells=32, dogma=True, context=64, frame="ground", period=0.05)
    material = {name: Material.of(drive, 10) for name, drive in Store(store).drives.items()}
    methods = forecasters(store, material, OUT, steps=1, seed=0, futures=2)
    shipped, fitted, corrected = (methods[name] for name in METHODS)
    assert isinstance(shipped, RolloutForecaster)
    assert isinstance(fitted, RolloutForecaster)
    assert isinstance(corrected, CorrectedRolloutForecaster)
    assert not np.array_equal(fitted.rates.hit, shipped.rates.hit)
    assert (corrected.rates, corrected.motion) == (fitted.rates, fitted.motion)
    weights = torch.cat([weight.detach().flatten() for weight in corrected.parameters()])
    return [fitted.rates.hit, fitted.rates.seen, np.array(list(vars(fitted.motion).values())), weights.numpy()]


def test_nothing_of_a_drive_that_is_left_out_is_learned(tmp_path: Path) -> None:
    """Whatever that drive holds, the same is learned, to the bit."""
    one, other = (learned(tmp_path / str(count), {"a": 40, "b": 40, "c": count}) for count in (40, 60))
    for found, again in zip(one, other, strict=True):
        np.testing.assert_array_equal(found, again)


def test_every_drive_is_left_out_once_and_has_a_row_of_its_own(tmp_path: Path) -> None:
    names = {"near": "abc", "far": "de"}
    for store, drives in names.items():
        frames = {name: list(range(40 if name != "b" else 70)) for name in drives}
        write_store(tmp_path / store, frames, cells=32, dogma=True, context=64, frame="ground", period=0.05)
    both = tmp_path / "both"
    both.mkdir()
    stores = joined([tmp_path / store for store in names], both)
    assert stores == {"near": ["a", "b", "c"], "far": ["d", "e"]}
    assert folds(stores, 2) == [["a", "c", "d"], ["b", "e"]]
    assert folds(stores, 9) == [["a", "d"], ["b", "e"], ["c"]]
    found = {}
    for out in folds(stores, 2):
        found.update(errors(RolloutForecaster(futures=1), both, out))
    assert {name: len(of) for name, of in found.items()} == {"a": 1, "b": 2, "c": 1, "d": 1, "e": 1}
    rows = table(stores, {"rollout": found}, 0.05, "").rows
    assert [row[0].text for row in rows] == [
        *("a", "b", "c", "near: mean of 3", "near: largest of 3"),
        *("d", "e", "far: mean of 2", "far: largest of 2"),
    ]
    shares = [[float(share) for share in row[2].text.split(", ")] for row in rows]
    rollout, static = found["b"].mean(axis=0)
    assert shares[1] == pytest.approx((rollout / static)[[1, 9, 19, 29]], abs=0.006)
    np.testing.assert_allclose(shares[3], np.mean(shares[:3], axis=0), atol=0.011)
    np.testing.assert_array_equal(shares[4], np.max(shares[:3], axis=0))
    with pytest.raises(UserError, match=r"near.*holds a drive a too"):
        joined([tmp_path / "near", tmp_path / "near"], both)
