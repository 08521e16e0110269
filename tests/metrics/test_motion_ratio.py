"""How much a forecast moves."""

import pytest
import torch

from envpred.metrics.motion_ratio import MotionRatio, motion_ratio

LAST = torch.tensor([[[0.0, 0.0, 1.0, 1.0]]])
TARGET = torch.tensor([[[[1.0, 0.0, 0.0, 1.0]]]])


def test_frozen_perfect_and_half() -> None:
    assert motion_ratio(LAST[:, None], TARGET, LAST).item() == 0
    assert motion_ratio(TARGET, TARGET, LAST).item() == 1
    # moves 0.3 + 0.1 + 0.4 of 2
    forecast = torch.tensor([[[[0.3, 0.1, 0.6, 1.0]]]])
    assert motion_ratio(forecast, TARGET, LAST).item() == pytest.approx(0.4)
    # the target moves 0.2 + 0.6, in cells that are neither full nor empty: 0.8 of 0.8
    target = torch.tensor([[[[0.2, 0.0, 0.4, 1.0]]]])
    assert motion_ratio(forecast, target, LAST).item() == pytest.approx(0.8 / 0.8)


def test_windows_that_stand_still_do_not_count() -> None:
    metric = MotionRatio(1)
    metric.update(TARGET, LAST[:, None], LAST)
    metric.update(TARGET, TARGET, LAST)
    result = metric.compute()
    assert result.mean.item() == 1
    assert result.per_window[0].isnan().all()


def test_the_last_grid_is_asked_for() -> None:
    with pytest.raises(ValueError, match="MotionRatio needs `last`"):
        MotionRatio(1).update(TARGET, TARGET)
