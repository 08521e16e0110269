"""Log score."""

from math import log

import pytest
import torch

from envpred.mapping.geometry import EGO, FREE, OCCUPIED, UNKNOWN
from envpred.metrics.log_score import LogScore, log_score

FORECAST = torch.tensor([[[[0.75, 0.25, 0.1, 0.9]]]])
LABEL = torch.tensor([[[[OCCUPIED, FREE, UNKNOWN, EGO]]]], dtype=torch.uint8)


def test_by_hand() -> None:
    assert log_score(FORECAST, LABEL).item() == pytest.approx(-log(0.01 + 0.98 * 0.75))
    assert log_score(1 - FORECAST, LABEL).item() == pytest.approx(-log(0.01 + 0.98 * 0.25))
    assert log_score(FORECAST, torch.zeros_like(LABEL)).isnan().all()


def test_a_sure_mistake_costs_no_more_than_the_smoothing_lets_it() -> None:
    sure = torch.tensor([[[[0.0, 1.0, 0.5, 0.5]]]])
    assert log_score(sure, LABEL).item() == pytest.approx(-log(0.01))
    assert log_score(1 - sure, LABEL).item() == pytest.approx(-log(0.99), abs=1e-6)


def test_kinds_of_cells_and_the_smoothing_is_named() -> None:
    metric = LogScore(1)
    metric.update(FORECAST, FORECAST, label=LABEL, static=LABEL != FREE)
    found = metric.compute()
    assert found["log_score_static_cells"].mean.item() == pytest.approx(-log(0.01 + 0.98 * 0.75))
    assert found["log_score"].about.title == "Log score, smoothed by 0.01"
