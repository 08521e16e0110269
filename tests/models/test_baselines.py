import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from envpred.datamodules import Seen
from envpred.errors import UserError
from envpred.models import FCNForecaster, MovedLastFrame, MovedLastFrameOracle, MovedParticles
from envpred.results.result import RESULT
from tests.models.trainers import grids, seen, trainer
from tests.store.stores import write_store


def shown(centres: list[list[int]], occupancy: torch.Tensor, given: int) -> Seen:
    """The first `given` frames, and for oracles where the others lie."""
    cells = torch.tensor(centres)
    pose = torch.cat([cells.float(), torch.zeros(len(cells), 1)], 1)
    return seen(
        occupancy=occupancy[None, :given],
        centre_cell=cells[None, :given],
        pose=pose[None, :given],
        future_centre_cell=cells[None, given:],
    )


def test_a_world_at_rest_is_forecast_exactly_but_for_what_enters() -> None:
    world = torch.rand(40, 8)
    centres = [[t, 4] for t in range(6)]
    frames = torch.stack([world[t : t + 8] for t in range(6)])
    model = MovedLastFrame(given=3, fill=0.25)
    forecast = model.forecast(shown(centres, frames, 3), 3).probability[0]
    for h in range(3):
        torch.testing.assert_close(forecast[h, : 8 - (h + 1)], frames[3 + h, : 8 - (h + 1)])
        assert (forecast[h, 8 - (h + 1) :] == 0.25).all()


def test_movers_are_carried_on_and_what_stands_is_moved() -> None:
    """A wall and a car: the car's cell is emptied, and stands where the particles say; the wall slides past."""
    frames = torch.zeros(3, 8, 8)
    frames[:, 6, 1], frames[:, 3, 4] = 0.9, 0.8  # wall and car in the last frame shown
    velocity, forecast = torch.zeros(1, 3, 2, 8, 8), torch.zeros(1, 3, 2, 8, 8, dtype=torch.uint8)
    velocity[0, 2, 0, 3, 4] = 10.0
    forecast[0, 2, 0, 4, 4] = forecast[0, 2, 1, 6, 4] = 204
    covariance = torch.zeros(1, 3, 3, 8, 8)
    covariance[:, :, [0, 2]] = 0.1
    window = shown([[t, 4] for t in range(5)], frames, 3)
    window["arrays"] = {"velocity": velocity, "velocity_cov": covariance, "particle_forecast": forecast}
    first, second = MovedParticles(given=3, fill=0.25).forecast(window, 2).probability[0]
    assert first[5, 1] == second[4, 1] == 0.9
    assert first[2, 4] == second[1, 4] == 0  # where the car would be, if it stood
    assert first[4, 4] == pytest.approx(0.8)
    assert second[6, 4] == pytest.approx(0.8)
    assert (first[7] == 0.25).all()


def test_moved_particles_are_tested_like_all_others(tmp_path: Path) -> None:
    store = write_store(tmp_path / "grids", {name: list(range(12)) for name in "abc"}, dogma=True)
    trainer(tmp_path).test(MovedParticles(given=3), datamodule=grids(store), verbose=False)
    result = json.loads((tmp_path / RESULT).read_text())
    assert (result["model"]["name"], result["role"]) == ("moved_particles", "particle")


def test_a_grid_that_leaves_entirely_is_all_fill() -> None:
    model = MovedLastFrameOracle(given=1, fill=0.25)
    assert (model.forecast(shown([[0, 0], [50, 0]], torch.rand(2, 8, 8), 1), 1).probability == 0.25).all()


def test_entering_cells_get_the_training_mean(store: Path, tmp_path: Path) -> None:
    model, data = MovedLastFrame(given=3), grids(store, train=["a"], val=["b"], test=["c"])
    trainer(tmp_path).test(model, datamodule=data, verbose=False)
    windows = data.datasets  # only the test windows are kept
    assert set(windows) == {"test"}
    expected = np.mean(
        [np.mean(np.concatenate([w[part]["occupancy"] for part in ("seen", "future")])) for w in _training(store)]
    )
    assert model.fill == pytest.approx(expected, abs=1e-6)
    result = json.loads((tmp_path / RESULT).read_text())
    assert result["model"]["name"] == "moved_last_frame"
    assert {"iou", "roc_auc", "brier", "image_similarity", "motion_ratio", "mse_static_cells"} <= set(result["metrics"])


def test_without_training_drives_entering_cells_get_the_mean_of_what_is_shown(store: Path, tmp_path: Path) -> None:
    model = MovedLastFrame(given=3)
    trainer(tmp_path).test(model, datamodule=grids(store, split="custom", test=["c"]), verbose=False)
    assert json.loads((tmp_path / RESULT).read_text())["model"]["hyperparameters"]["filled_with"] == "frames shown"
    world = torch.rand(8, 8)
    moving = MovedLastFrameOracle(given=2)
    torch.testing.assert_close(
        moving.forecast(shown([[0, 0], [0, 0], [50, 0]], world.expand(3, 8, 8), 2), 1).probability,
        world.mean().expand(1, 1, 8, 8),
    )


def _training(store: Path) -> Any:
    data = grids(store, train=["a"], val=["b"])
    data.setup("fit")
    return data.datasets["train"]


def test_fcn_trains_and_forecasts(store: Path, tmp_path: Path) -> None:
    model = FCNForecaster(given=3, horizons=5, width=0.05, max_epochs=2)
    frames = torch.rand(2, 3, 2, 32, 32)
    model.eval()
    forecast = model.forecast(seen(frames=frames), 5).probability
    assert forecast.shape == (2, 5, 32, 32)
    other = frames.clone()
    other[:, :2] = 0.0  # it reads the last frame shown and nothing else
    torch.testing.assert_close(model.forecast(seen(frames=other), 5).probability, forecast)
    with pytest.raises(UserError, match="reaches 4 frames ahead"):
        trainer(tmp_path).test(FCNForecaster(given=3, horizons=4, width=0.05), datamodule=grids(store), verbose=False)
