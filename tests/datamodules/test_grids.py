import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from envpred.datamodules import GridDataModule, Needs
from envpred.datamodules.selection import select
from envpred.datamodules.variants import VARIANTS, variant
from envpred.datamodules.windows import Draw, RandomWindows, windows_in_order
from envpred.errors import UserError
from envpred.mapping.evidence import pignistic
from envpred.store import Store
from tests.store.stores import write_store

LENGTH = 8


@pytest.fixture
def store(tmp_path: Path) -> Path:
    return write_store(
        tmp_path / "grids", {"a": list(range(30)), "b": [*range(12), *range(20, 50)], "c": list(range(17))}
    )


def data(store: Path, **options: object) -> GridDataModule:
    return GridDataModule(store, length=LENGTH, given=3, **options)  # type: ignore[arg-type]


def whole(batch: Any, name: str) -> torch.Tensor:
    """A field of all frames of a batch or a window, those shown and those to come."""
    return torch.cat([batch["seen"][name], batch["future"][name]], dim=int(isinstance(batch["index"], torch.Tensor)))


def test_windows_in_order_take_each_frame_once_and_cross_no_gap(store: Path) -> None:
    module = data(store, test=["b"])
    module.setup("test")
    assert [(p.drive.name, p.start) for p in module.datasets["test"].places] == [
        ("b", 0),
        ("b", 12),
        ("b", 20),
        ("b", 28),
    ]


def test_a_batch_is_what_the_store_holds(store: Path) -> None:
    module = data(store, test=["c"], batch_size=2)
    module.setup("test")
    (batch,) = list(module.test_dataloader())
    drive = Store(store).drives["c"]
    mass = drive.array("evidence").astype(np.float32)
    for b, start in enumerate((0, LENGTH)):
        cut = slice(start, start + LENGTH)
        np.testing.assert_array_equal(whole(batch, "frames")[b], mass[cut])
        np.testing.assert_array_equal(whole(batch, "occupancy")[b], pignistic(mass[cut]))
        assert batch["future"] is not None
        np.testing.assert_array_equal(
            batch["future"]["occupied_mass"][b], mass[cut][-batch["future"]["label"].shape[1] :, 0]
        )
        np.testing.assert_array_equal(whole(batch, "label")[b], drive.array("label")[cut])
        np.testing.assert_array_equal(whole(batch, "centre_cell")[b], drive.array("centre_cell")[cut])
        cells = (drive.array("pose")[cut, :2, 3] - drive.origin) * 3
        np.testing.assert_allclose(whole(batch, "pose")[b, :, :2], cells, rtol=1e-6)
        np.testing.assert_array_equal(whole(batch, "pose")[b, :, 2], np.zeros(LENGTH))
    seen = batch["seen"]
    assert seen["frames"].shape[1] == 3
    np.testing.assert_allclose(seen["time"], [[-0.2, -0.1, 0.0]] * 2, atol=1e-6)
    np.testing.assert_allclose(seen["sensor"], [[*drive.sensor_to_body[:2, 3], 0.0]] * 2)
    np.testing.assert_allclose(seen["body"], [[-0.81, 1.95, 0.8]] * 2)
    np.testing.assert_allclose(seen["resolution"], [1 / 3] * 2)
    np.testing.assert_allclose(seen["period"], [0.1] * 2)
    assert batch["drive"] == ["c", "c"]
    assert batch["index"].tolist() == [0, 1]
    assert batch["start"].tolist() == [0, LENGTH]


def test_prob_static_is_pignistic(store: Path) -> None:
    module = data(store, variant="prob_static", test=["c"])
    module.setup("test")
    window = module.datasets["test"][0]
    torch.testing.assert_close(whole(window, "frames")[:, 0], whole(window, "occupancy"))


def test_probability_of_forecast_channels() -> None:
    masses = torch.tensor([0.6, 0.3]).view(2, 1, 1)
    assert variant("dst_static").probability(masses).item() == pytest.approx(0.5 * 0.6 + 0.5 * 0.7)
    assert variant("prob_static").probability(masses[:1]).item() == pytest.approx(0.6)
    with pytest.raises(UserError, match="dst_static"):
        variant("dst")


def test_random_windows_depend_on_seed_and_epoch_alone() -> None:
    epoch = 0
    sampler = RandomWindows(50, 20, seed=7, augment=True, epoch=lambda: epoch)
    first = list(sampler)
    assert list(sampler) == first
    assert {draw.symmetry for draw in RandomWindows(50, 500, 7, True, lambda: 0)} == set(range(8))
    assert {(d.symmetry, d.corner) for d in RandomWindows(50, 500, 7, False, lambda: 0)} == {(0, (0, 0))}
    epoch = 1
    assert list(sampler) != first


def test_training_windows_are_turned_whole(store: Path) -> None:
    module = data(store, train=["a"], val=["c"])
    module.setup("fit")
    windows = module.datasets["train"]
    plain, turned = windows[3], windows[Draw(3, 5)]
    for name in ("frames", "occupancy", "label"):
        torch.testing.assert_close(whole(turned, name), whole(plain, name).transpose(-1, -2).flip(-1))
    pose = whole(turned, "pose")
    assert pose[1, 1] - pose[0, 1] == pytest.approx(-1 / 3, abs=1e-4)  # east has become south


def test_a_crop_is_the_same_part_of_every_frame(store: Path) -> None:
    uncut = data(store, train=["a"], val=["c"], augment=True)
    cropped = data(store, train=["a"], val=["c"], augment=True, crop=6)
    for module in (uncut, cropped):
        module.setup("fit")
    cells = uncut.cells
    item = cropped.datasets["train"][Draw(3, 5, (2, 7))]
    full = uncut.datasets["train"][Draw(3, 5)]
    for name in ("frames", "occupancy", "label"):
        torch.testing.assert_close(whole(item, name), whole(full, name)[..., 2:8, 7:13])
    # The middle of the part, cell 3 of 6, is cell 5 and 10 of the whole grid.
    shift = torch.tensor([5 - cells // 2, 10 - cells // 2], dtype=torch.int32)
    torch.testing.assert_close(whole(item, "centre_cell"), whole(full, "centre_cell") + shift)
    assert cropped.datasets["val"][0]["seen"]["occupancy"].shape[-1] == cells
    corners = {draw.corner for draw in cropped.train_dataloader().sampler}
    assert max(max(c) for c in corners) <= cells - 6
    assert len(corners) > 10
    assert {w["seen"]["occupancy"].shape[-1] for w in cropped.train_dataloader()} == {6}


@pytest.mark.parametrize("crop", [0, 10_000])
def test_a_crop_that_does_not_fit_is_refused(store: Path, crop: int) -> None:
    with pytest.raises(UserError, match=f"--data.crop {crop}: the grids have"):
        data(store, train=["a"], val=["c"], crop=crop).setup("fit")


def test_validation_windows_are_spread_over_the_drives(store: Path) -> None:
    module = data(store, train=["a@-12"], val=["a@12-", "b", "c"], val_windows=3)
    module.setup("fit")
    places = windows_in_order(module.selected["val"], LENGTH)
    chosen = module.datasets["val"].places
    assert [chosen[0], chosen[-1]] == [places[0], places[-1]]
    assert len(chosen) == 3


def test_samples_and_batches(store: Path) -> None:
    module = data(store, train=["a"], val=["c"], samples=10, batch_size=4)
    module.setup("fit")
    loader = module.train_dataloader()
    assert isinstance(loader, DataLoader)
    assert [len(batch["start"]) for batch in loader] == [4, 4]  # what is left of an epoch is dropped


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (
            {"test": ["c"], "length": 18},
            "no window of 18 frames fits into c, whose longest stretch without a gap has 17",
        ),
        ({"test": ["d"]}, "names drive d, which the store does not hold; it has a, b, c"),
        ({"split": "reference"}, "2011_09_26_drive_0005_sync"),
        ({"split": "custom", "train": ["a"]}, "leaves no drive to test"),
        ({"given": 0}, "--data.given 0"),
        ({"given": 20, "length": 20}, "--data.given 20"),
        ({"samples": 0}, "--data.samples"),
        ({"variant": "dst_statik"}, "no input variant 'dst_statik'; there are dst_static"),
        ({"variant": "nowhere.MINE"}, "variant nowhere.MINE: No module named 'nowhere'; give a module that Python"),
        ({"variant": "envpred.MINE"}, "variant envpred.MINE: envpred holds no Variant of that name; give one that"),
    ],
)
def test_what_does_not_fit_is_refused(store: Path, options: dict[str, object], line: str) -> None:
    with pytest.raises(UserError, match=line):
        GridDataModule(store, **options).setup("test")  # type: ignore[arg-type]


def test_a_store_of_mixed_parameters_is_refused(store: Path) -> None:
    write_store(store.parent / "other", {"d": list(range(30))}, parameters={"cells": 16, "other": 1})
    (store.parent / "other" / "d").rename(store / "d")
    with pytest.raises(UserError, match="the mapping grids of d were built with other parameters"):
        data(store, test=["d"]).setup("test")


@pytest.mark.parametrize(
    "asked",
    [
        {"test": ["c", "c"]},
        {"train": ["a"], "val": ["a@20-"]},
        {"train": ["a@-10"], "val": ["b"], "test": ["a@9-"]},
    ],
)
def test_frames_that_are_taken_twice_are_refused(store: Path, asked: dict[str, list[str]]) -> None:
    """A window that counts twice shrinks a standard error; a drive that trains must not judge."""
    with pytest.raises(UserError, match=r"which share frames; give other drives, or stretches that do not overlap"):
        data(store, **asked).setup("test")


def test_one_drive_may_be_shared_by_stretches(store: Path) -> None:
    module = data(store, train=["a@-10"], val=["a@10-20"], test=["a@20-"])
    module.setup("test")
    assert [str(s) for part in ("train", "val", "test") for s in module.selected[part]] == [
        "a@0-10",
        "a@10-20",
        "a@20-30",
    ]


def test_what_is_named_leaves_the_splits_other_parts(store: Path) -> None:
    module = data(store, test=["a"])
    module.setup("test")
    assert {part: [str(s) for s in selections] for part, selections in module.selected.items()} == {
        "train": [],
        "val": ["b"],
        "test": ["a"],
    }


def test_predictions_without_targets_are_of_the_drives_named_or_of_all(store: Path) -> None:
    for test, drives in ((None, ["a", "b", "c"]), (["b"], ["b"])):
        module = data(store, test=test, predict="newest")
        module.setup("predict")
        assert [place.drive.name for place in module.datasets["predict"].places] == drives


def test_drives_of_another_rate_are_refused(store: Path) -> None:
    write_store(store, {"d": list(range(30))}, period=0.05)
    with pytest.raises(UserError, match=r"its drives differ \(a: 0\.1 s between frames.*; d: 0\.05 s"):
        data(store).setup("fit")


@pytest.mark.parametrize("array", ["velocity", "context_label"])
def test_arrays_of_other_parameters_are_refused(store: Path, array: str) -> None:
    """Velocities and wide grids as well as the mapping: they would train silently."""
    write_store(store, {"d": list(range(30))}, dogma=True, context=32)
    write_store(store.parent / "other", {"e": list(range(30))}, dogma=True, context=32)
    manifest = store.parent / "other" / "e" / "manifest.json"
    told = json.loads(manifest.read_text())
    group = told["arrays"][array]["group"]
    told["groups"][group] = "0123456789abcdef"
    manifest.write_text(json.dumps(told))
    (store.parent / "other" / "e").rename(store / "e")
    module = data(store, test=["d", "e"])
    module.selected = {"test": select(["d", "e"], Store(store).drives)}
    needs = Needs(arrays=("velocity",)) if array == "velocity" else Needs(context=True)
    module.trainer = SimpleNamespace(lightning_module=SimpleNamespace(needs=needs))  # type: ignore[assignment]
    with pytest.raises(UserError, match=f"the {group} grids of e were built with other parameters"):
        module.setup("test")


def test_an_unfinished_store_is_named(store: Path) -> None:
    for drive in "abc":
        (store / drive / "manifest.json").unlink()
    with pytest.raises(UserError, match=r"holds no finished drive \(a, b, c unfinished\)"):
        data(store).setup("fit")
    with pytest.raises(UserError, match="no store of grids"):
        GridDataModule(store.parent).setup("fit")


def test_description_changes_with_the_content(store: Path, tmp_path: Path) -> None:
    def described(store: Path) -> dict[str, object]:
        module = data(store, test=["c"])
        module.setup("test")
        return module.describe("test")

    before = described(store)
    assert before["windows"] == [["c", 0], ["c", LENGTH]]
    other = write_store(tmp_path / "other", {"c": list(range(17))}, seed=1)
    assert described(other)["store_hash"] != before["store_hash"]


def test_every_variant_names_its_channels() -> None:
    for name, view in VARIANTS.items():
        assert view.evidential == name.startswith("dst")
        assert len(view.channels) == {"dst_static": 2, "prob_static": 1, "dst_dogma": 4, "prob_dogma": 3}[name]


def test_grids_that_are_built_again_meanwhile_end_what_reads_them(store: Path) -> None:
    """They would change what is trained on, and not the hash that is told of it."""
    module = data(store)
    module.setup("fit")
    before, window = module.describe("train")["store_hash"], module.datasets["train"][0]
    write_store(store, {"a": list(range(30))}, seed=1)
    with pytest.raises(UserError, match=r"a: '\w+' was built again while it was read; run this command again"):
        module.datasets["train"][0]
    assert module.describe("train")["store_hash"] == before
    again = data(store)
    again.setup("fit")
    assert again.describe("train")["store_hash"] != before
    assert not torch.equal(again.datasets["train"][0]["seen"]["frames"], window["seen"]["frames"])
