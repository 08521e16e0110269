"""Brier score, calibration error, reliability diagram."""

import math

import pytest
import torch

from envpred.mapping.geometry import EGO
from envpred.metrics.brier import Brier, brier
from envpred.metrics.calibration import Calibration, Reliability, reliability_bins
from envpred.metrics.windows import PerHorizon
from tests.metrics.labels import labelled

TARGET = torch.tensor([[[[0.9, 0.6, 0.1, 0.0, 0.5]]]])
LABEL = labelled(TARGET)
FORECAST = torch.tensor([[[[0.75, 0.5, 0.25, 1.0, 0.9]]]])


def test_brier_by_hand() -> None:
    # outcomes 1, 1, 0, 0: squares 0.0625, 0.25, 0.0625, 1
    assert brier(FORECAST, LABEL).item() == pytest.approx(1.375 / 4)
    assert brier(FORECAST, torch.zeros_like(LABEL)).isnan().all()


def test_brier_of_kinds_of_cells_by_hand() -> None:
    metric = Brier(horizons=1)
    metric.update(FORECAST, TARGET, label=LABEL, changed=TARGET < 0.5, moving=TARGET > 0.4, entering=TARGET == 0.5)
    found = {name: value.mean.item() for name, value in metric.compute().items()}
    assert found["brier"] == pytest.approx(1.375 / 4)
    assert found["brier_changed_cells"] == pytest.approx((0.0625 + 1) / 2)
    assert math.isnan(found["brier_static_cells"])  # not told
    assert found["brier_moving_cells"] == pytest.approx((0.0625 + 0.25) / 2)  # what was not measured does not count
    assert math.isnan(found["brier_entering_cells"])


def test_bins_by_hand() -> None:
    count, forecast, occupied = reliability_bins(FORECAST, LABEL, bins=2)[0, 0].tolist()
    assert count == [1, 3]
    assert forecast == pytest.approx([0.25, 2.25])
    assert occupied == [0, 2]


def test_kinds_of_cells_have_bins_of_their_own() -> None:
    generator = torch.Generator().manual_seed(1)
    forecast, target = torch.rand(2, 2, 3, 6, 7, generator=generator).round(decimals=1)
    label = labelled(target)
    kinds = torch.rand(3, 2, 3, 6, 7, generator=generator) < torch.tensor([0.3, 0.6, 0.0]).view(3, 1, 1, 1, 1)
    found = reliability_bins(forecast, label, 10, kinds)
    for kind, cells in zip(found, kinds, strict=True):
        torch.testing.assert_close(kind, reliability_bins(forecast, label.where(cells, torch.tensor(EGO).byte()), 10))
    metric = Calibration(horizons=1, bins=2)
    metric.update(FORECAST, TARGET, label=LABEL, moving=TARGET > 0.8, entering=TARGET < 0.3)
    result = metric.compute()
    means = {name: value.mean.item() for name, value in result.items() if isinstance(value, PerHorizon)}
    assert means["ece_moving_cells"] == pytest.approx(0.25)  # the first: 0.75 where it is occupied
    assert means["ece_entering_cells"] == pytest.approx((0.25 + 1) / 2)
    assert math.isnan(means["ece_changed_cells"])  # not told


def test_error_and_diagram_over_windows() -> None:
    metric = Calibration(horizons=1, bins=2)
    metric.update(FORECAST, TARGET, index=torch.tensor([0]), label=LABEL)
    # every cell said 0.75: half of them occupied
    half = torch.tensor([[[[1.0, 1.0, 0.0, 0.0, 0.5]]]])
    metric.update(torch.full_like(FORECAST, 0.75), half, index=torch.tensor([1]), label=labelled(half))
    metric.update(FORECAST, TARGET, index=torch.tensor([0]), label=LABEL)
    result = metric.compute()
    ece, diagram = result["ece"], result["reliability"]
    assert isinstance(ece, PerHorizon)
    assert isinstance(diagram, Reliability)
    # window 0: |0.25 - 0|/4 + |2.25 - 2|/4; window 1: |3 - 2|/4
    assert ece.per_window.flatten().tolist() == pytest.approx([0.125, 0.25])
    # together: the upper bin has 7 cells, forecasts 5.25, occupied 4
    assert diagram.ece.item() == pytest.approx((0.25 + 1.25) / 8)
    assert diagram.count.tolist() == [[1, 7]]
    assert diagram.forecast[0].tolist() == pytest.approx([0.25, 0.75])
    assert diagram.occupied[0].tolist() == pytest.approx([0, 4 / 7])


def test_empty_bins_are_none_in_a_result_file() -> None:
    diagram = Reliability(reliability_bins(FORECAST[..., :1], LABEL[..., :1], bins=2)[0])
    assert diagram.as_json() == {
        "ece": [0.25],
        "count": [[0, 1]],
        "forecast": [[None, 0.75]],
        "occupied": [[None, 1.0]],
    }


def test_a_calibrated_forecast_has_little_error() -> None:
    generator = torch.Generator().manual_seed(2)
    forecast = torch.rand(1, 1, 300, 300, generator=generator)
    target = (torch.rand(forecast.shape, generator=generator) < forecast).float()
    metric = Calibration(1)
    metric.update(forecast, target, label=labelled(target))
    ece = metric.compute()["ece"]
    assert isinstance(ece, PerHorizon)
    assert ece.mean.item() < 0.01
    metric.update(forecast**2, target, label=labelled(target))
    shifted = metric.compute()["ece"]
    assert isinstance(shifted, PerHorizon)
    assert shifted.per_window[1].item() == pytest.approx(1 / 2 - 1 / 3, abs=0.01)
