import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from envpred.errors import UserError
from envpred.models import FCNForecaster, MovedLastFrame, MovedLastFrameOracle
from envpred.results.result import RESULT
from tests.models.trainers import grids, trainer


def batch(centres: list[list[int]], occupancy: torch.Tensor) -> Any:
    cells = torch.tensor(centres)
    pose = torch.cat([cells.float(), torch.zeros(len(cells), 1)], 1)
    return {"occupancy": occupancy[None], "centre_cell": cells[None], "pose": pose[None]}


def test_a_world_at_rest_is_forecast_exactly_but_for_what_enters() -> None:
    world = torch.rand(40, 8)
    centres = [[t, 4] for t in range(6)]
    seen = torch.stack([world[t : t + 8] for t in range(6)])
    model = MovedLastFrame(given=3, fill=0.25)
    forecast = model.forecast(batch(centres, seen), 3)[0]
    for h in range(3):
        torch.testing.assert_close(forecast[h, : 8 - (h + 1)], seen[3 + h, : 8 - (h + 1)])
        assert (forecast[h, 8 - (h + 1) :] == 0.25).all()


def test_a_grid_that_leaves_entirely_is_all_fill() -> None:
    model = MovedLastFrameOracle(given=1, fill=0.25)
    assert (model.forecast(batch([[0, 0], [50, 0]], torch.rand(2, 8, 8)), 1) == 0.25).all()


def test_future_poses_are_not_read() -> None:
    data = batch([[t, 4] for t in range(6)], torch.rand(6, 8, 8))
    before = MovedLastFrame(given=3, fill=0.5).forecast(data, 3)
    data["pose"][:, 3:], data["centre_cell"][:, 3:] = math.nan, 99
    torch.testing.assert_close(MovedLastFrame(given=3, fill=0.5).forecast(data, 3), before)


def test_entering_cells_get_the_training_mean(store: Path, tmp_path: Path) -> None:
    model, data = MovedLastFrame(given=3), grids(store, train=["a"], val=["b"], test=["c"])
    trainer(tmp_path).test(model, datamodule=data, verbose=False)
    windows = data.datasets  # only the test windows are kept
    assert set(windows) == {"test"}
    expected = np.mean([w["occupancy"].mean() for w in _training(store)])
    assert model.fill == pytest.approx(expected, abs=1e-6)
    result = json.loads((tmp_path / RESULT).read_text())
    assert result["model"]["name"] == "moved_last_frame"
    assert {"iou", "roc_auc", "brier", "image_similarity", "motion_ratio", "mse_dynamic_cells"} <= set(
        result["metrics"]
    )


def _training(store: Path) -> Any:
    data = grids(store, train=["a"], val=["b"])
    data.setup("fit")
    return data.datasets["train"]


def test_fcn_trains_and_forecasts(store: Path, tmp_path: Path) -> None:
    model = FCNForecaster(given=3, horizons=5, width=0.05, max_epochs=2)
    frames = torch.rand(2, 8, 2, 32, 32)
    forecast = model.forecast({"frames": frames}, 3)  # type: ignore[typeddict-item]
    assert forecast.shape == (2, 5, 32, 32)
    other = frames.clone()
    other[:, :2], other[:, 3:] = 0.0, 0.0  # it reads the last frame shown and nothing else
    model.eval()
    torch.testing.assert_close(
        model.forecast({"frames": other}, 3),  # type: ignore[typeddict-item]
        model.forecast({"frames": frames}, 3),  # type: ignore[typeddict-item]
    )
    with pytest.raises(UserError, match=r"--model\.horizons 4"):
        trainer(tmp_path).test(FCNForecaster(given=3, horizons=4, width=0.05), datamodule=grids(store), verbose=False)
