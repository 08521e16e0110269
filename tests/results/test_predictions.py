"""A folder of predictions as a scene: what its manifest says, and what the store adds."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from envpred.errors import UserError
from envpred.mapping.evidence import pignistic
from tests.results.predictions import FORECAST, folder_of, store_of


@pytest.mark.parametrize(("role", "bound"), [("learned", set()), ("oracle", {"Mine"})])
def test_cells_period_and_role_are_the_manifests(tmp_path: Path, role: str, bound: set[str]) -> None:
    scene = folder_of(tmp_path, FORECAST, role=role).scene(0)
    assert (scene.resolution, scene.period) == (0.2, 0.05)
    assert scene.oracles == bound
    assert len(scene.seen) == 0


@pytest.mark.parametrize("context", [None, 16])
def test_the_wider_grid_is_shown_if_the_forecaster_read_it(tmp_path: Path, context: int | None) -> None:
    random = np.random.default_rng(0)
    arrays: dict[str, NDArray[Any]] = {
        "evidence": 0.5 * random.random((7, 2, 8, 8)),
        "context_evidence": 0.5 * random.random((7, 2, 16, 16)),
        "centre_cell": np.arange(14).reshape(7, 2),
    }
    scene = folder_of(tmp_path, FORECAST, data={"context": context}).scene(0, store_of(arrays))
    assert (len(scene.seen), len(scene.target)) == (2, 2)
    np.testing.assert_allclose(scene.seen, pignistic(arrays["evidence"][3:5]), rtol=1e-6)
    if context is None:
        assert scene.context is None
    else:
        assert scene.context is not None
        np.testing.assert_allclose(scene.context, pignistic(arrays["context_evidence"][4]), rtol=1e-6)


def test_windows_where_the_store_has_other_frames_are_refused(tmp_path: Path) -> None:
    arrays: dict[str, NDArray[Any]] = {"evidence": np.zeros((7, 2, 8, 8)), "centre_cell": np.zeros((7, 2))}
    predictions, store = folder_of(tmp_path, FORECAST), store_of(arrays)
    for change in ({"frames": [4, 5]}, {"start": 2}, {"targets": 3}):
        before = dict(predictions.windows[0])
        predictions.windows[0].update(change)
        with pytest.raises(UserError, match="does not hold the grids of a that"):
            predictions.scene(0, store)
        predictions.windows[0].update(before)
    assert len(predictions.scene(0, store).target) == 2


def test_a_forecast_outside_the_folder_is_not_read(tmp_path: Path) -> None:
    np.save(tmp_path / "4.npy", FORECAST)
    predictions = folder_of(tmp_path / "predictions", FORECAST)
    predictions.windows[0]["file"] = "../4.npy"
    with pytest.raises(UserError, match=r"manifest\.json: names '\.\./4\.npy'"):
        predictions.forecast(0)
