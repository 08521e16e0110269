"""Forecast h is compared with frame given + h, and with no other."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from envpred.datamodules import WindowBatch
from envpred.mapping.evidence import pignistic
from envpred.models.forecaster import Forecaster
from envpred.results.result import RESULT
from envpred.store import Store
from tests.models.trainers import grids, trainer


class Seer(Forecaster):
    """Looks up the frames to come, `late` frames too late."""

    def __init__(self, late: int) -> None:
        super().__init__("dst_static", given=3)
        self.late = late

    def forecast(self, batch: WindowBatch, given: int = 5, horizons: int | None = None) -> Tensor:
        frames = batch["occupancy"]
        looked_up = torch.arange(given, frames.shape[1]) - self.late
        return frames[:, looked_up]

    def configure_optimizers(self) -> None:
        """Nothing is trained."""


@pytest.mark.parametrize("late", [0, 1, 2])
def test_a_seer_errs_only_by_its_delay(store: Path, tmp_path: Path, late: int) -> None:
    trainer(tmp_path).test(Seer(late), datamodule=grids(store, test=["c"], batch_size=2), verbose=False)
    mse = json.loads((tmp_path / RESULT).read_text())["metrics"]["mse"]["per_window"]
    probability = pignistic(np.asarray(Store(store).drives["c"].array("evidence")))
    starts, horizons = np.arange(3)[:, None] * 8, np.arange(5)
    true, told = probability[starts + 3 + horizons], probability[starts + 3 + horizons - late]
    np.testing.assert_allclose(mse, ((true - told) ** 2).mean(axis=(2, 3)), rtol=1e-5, atol=1e-12)
    assert (np.max(mse) > 0) == (late > 0)
