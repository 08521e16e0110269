"""Forecast h is compared with frame given + h, and with no other."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from envpred.datamodules import Forecast, Seen
from envpred.mapping.evidence import pignistic
from envpred.models.forecaster import Forecaster
from envpred.results.result import RESULT
from envpred.store import Store
from tests.models.trainers import grids, trainer


class Seer(Forecaster):
    """Knows a drive by heart, looks up where it is, and tells the frames to come, `late` frames too late."""

    def __init__(self, drive: Tensor, late: int) -> None:
        super().__init__("dst_static", given=3)
        self.drive, self.late = drive, late

    def forecast(self, seen: Seen, horizons: int) -> Forecast:
        last = seen["occupancy"][:, -1]
        now = (self.drive[None] - last[:, None]).square().sum((2, 3)).argmin(1)
        return Forecast(self.drive[now[:, None] + torch.arange(1, horizons + 1) - self.late])


@pytest.mark.parametrize("late", [0, 1, 2])
def test_a_seer_errs_only_by_its_delay(store: Path, tmp_path: Path, late: int) -> None:
    probability = pignistic(np.asarray(Store(store).drives["c"].array("evidence")))
    seer = Seer(torch.from_numpy(probability), late)
    trainer(tmp_path).test(seer, datamodule=grids(store, test=["c"], batch_size=2), verbose=False)
    mse = json.loads((tmp_path / RESULT).read_text())["metrics"]["mse"]["per_window"]
    starts, horizons = np.arange(3)[:, None] * 8, np.arange(5)
    true, told = probability[starts + 3 + horizons], probability[starts + 3 + horizons - late]
    np.testing.assert_allclose(mse, ((true - told) ** 2).mean(axis=(2, 3)), rtol=1e-5, atol=1e-12)
    assert (np.max(mse) > 0) == (late > 0)
