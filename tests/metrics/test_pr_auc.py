"""Area under the precision-recall curve."""

import math

import pytest
import torch

from envpred.mapping.geometry import EGO, FREE, OCCUPIED, UNKNOWN
from envpred.metrics.pr_auc import PrAuc, pr_auc
from tests.metrics.labels import labelled


def codes(*label: int) -> torch.Tensor:
    return torch.tensor([[[label]]], dtype=torch.uint8)


def test_by_hand() -> None:
    """Down to 0.9: 1 of 1; to 0.6: 1 of 2; to 0.3: 2 of 3, where precision goes as t / (t + 1) for t from 1 to 2."""
    forecast = torch.tensor([[[[0.9, 0.6, 0.3, 0.1, 0.95, 0.95]]]])
    label = codes(OCCUPIED, FREE, OCCUPIED, FREE, UNKNOWN, EGO)
    assert pr_auc(forecast, label).item() == pytest.approx(0.5 + (1 - math.log(1.5)) / 2)


def test_forecasts_between_two_of_a_hundred_thresholds_are_one_step() -> None:
    """One of two said together is right: from there on half of what more is said."""
    forecast = torch.tensor([[[[0.5055, 0.5145]]]])  # 50/99 = 0.50505, 51/99 = 0.51515
    assert pr_auc(forecast, codes(OCCUPIED, FREE)).item() == pytest.approx(0.5)
    apart = torch.tensor([[[[0.52, 0.51]]]])
    assert pr_auc(apart, codes(OCCUPIED, FREE)).item() == pytest.approx(1.0)
    after = torch.tensor([[[[0.9, 0.5055, 0.5145]]]])  # from 0 of 1 to 2 of 3: precision t / (t + 1) for t from 0 to 2
    assert pr_auc(after, codes(FREE, OCCUPIED, OCCUPIED)).item() == pytest.approx((2 - math.log(3)) / 2)
    at = torch.tensor([[[[1 / 3, 0.33]]]])  # a forecast at a threshold is not above it
    assert pr_auc(at, codes(OCCUPIED, FREE)).item() == pytest.approx(0.5)


def test_the_bounds_of_probability_count() -> None:
    forecast = torch.tensor([[[[1.0, 0.0]]]])
    assert pr_auc(forecast, codes(OCCUPIED, FREE)).item() == pytest.approx(1.0)
    # the highest step holds what is above 98/99 = 0.98990 alone
    assert pr_auc(torch.tensor([[[[0.995, 0.985]]]]), codes(OCCUPIED, FREE)).item() == pytest.approx(1.0)
    # nothing above 0, then all: half of it occupied
    assert pr_auc(torch.zeros(1, 1, 1, 2), codes(OCCUPIED, FREE)).item() == pytest.approx(0.5)


def test_a_blind_forecast_has_the_share_of_occupied_cells() -> None:
    generator = torch.Generator().manual_seed(0)
    forecast, drawn = torch.rand(2, 1, 2, 200, 200, generator=generator)
    label = labelled((drawn < 0.2).float())
    assert pr_auc(forecast, label).flatten().tolist() == pytest.approx([0.2, 0.2], abs=0.01)


def test_windows_without_an_occupied_cell_do_not_count() -> None:
    metric = PrAuc(1)
    forecast = torch.tensor([[[[0.9, 0.1]]]])
    metric.update(forecast, forecast, label=codes(FREE, FREE))
    metric.update(forecast, forecast, label=codes(OCCUPIED, FREE))
    assert metric.compute().mean.item() == pytest.approx(1.0)
    assert metric.compute().per_window[0].isnan().all()
