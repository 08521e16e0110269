"""Squared error over dynamic and static cells."""

import math

import pytest
import torch

from envpred.metrics.changed_cells import DynamicMSE, EnteringMSE, MovingMSE, StaticMSE, changed, masked_mse

LAST = torch.tensor([[[1.0, 0.0], [0.5, 0.0]]])
TARGET = torch.tensor([[[[0.0, 0.0], [0.9, 0.5]]]])  # left, stayed free, came, lost sight of
FORECAST = torch.tensor([[[[0.4, 0.1], [0.5, 0.2]]]])


def test_by_hand() -> None:
    assert changed(TARGET, LAST).flatten().tolist() == [True, False, True, False]
    dynamic, static = DynamicMSE(1), StaticMSE(1)
    dynamic.update(FORECAST, TARGET, LAST)
    static.update(FORECAST, TARGET, LAST)
    assert dynamic.compute().mean.item() == pytest.approx((0.16 + 0.16) / 2)
    assert static.compute().mean.item() == pytest.approx((0.01 + 0.09) / 2)


def test_cells_that_are_told_by_hand() -> None:
    moving = torch.tensor([[[[True, False], [False, True]]]])
    metrics = [MovingMSE(1), EnteringMSE(1)]
    for metric in metrics:
        metric.update(FORECAST, TARGET, LAST, moving=moving, entering=~moving)
        metric.update(FORECAST, TARGET, LAST)  # not told: does not count
    assert metrics[0].compute().mean.item() == pytest.approx((0.16 + 0.09) / 2)
    assert metrics[1].compute().mean.item() == pytest.approx((0.01 + 0.16) / 2)


def test_normalised_by_all_cells() -> None:
    dynamic, static = DynamicMSE(1, normalise="all"), StaticMSE(1, normalise="all")
    dynamic.update(FORECAST, TARGET, LAST)
    static.update(FORECAST, TARGET, LAST)
    total = dynamic.compute().mean + static.compute().mean
    assert total.item() == pytest.approx((FORECAST - TARGET).square().mean().item())


def test_without_dynamic_cells_undefined_and_not_counted() -> None:
    nothing = torch.zeros(1, 1, 2, 2)
    assert masked_mse(FORECAST, TARGET, nothing.bool()).isnan().all()
    metric = DynamicMSE(1)
    metric.update(FORECAST, TARGET, LAST)
    metric.update(FORECAST, LAST[:, None], LAST)
    result = metric.compute()
    assert result.mean.item() == pytest.approx(0.16)
    assert math.isnan(result.per_window[1].item())


def test_misuse_is_refused() -> None:
    with pytest.raises(ValueError, match="'masked' or 'all'"):
        DynamicMSE(1, normalise="some")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="needs `last`"):
        StaticMSE(1).update(FORECAST, TARGET)
