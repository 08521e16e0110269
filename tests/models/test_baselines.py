import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from envpred.datamodules import Seen
from envpred.errors import UserError
from envpred.models import FCNForecaster, MovedLastFrame, MovedLastFrameOracle
from envpred.results.result import RESULT
from tests.models.trainers import grids, seen, trainer


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
    assert {"iou", "roc_auc", "brier", "image_similarity", "motion_ratio", "mse_dynamic_cells"} <= set(
        result["metrics"]
    )


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
