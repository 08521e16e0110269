"""Squared error over kinds of cells."""

import math

import pytest
import torch

from envpred.metrics.changed_cells import ChangedMSE, EnteringMSE, MovingMSE, StaticMSE, masked_mse
from envpred.metrics.windows import HorizonMetric

TARGET = torch.tensor([[[[0.0, 0.0], [0.9, 0.5]]]])
FORECAST = torch.tensor([[[[0.4, 0.1], [0.5, 0.2]]]])
CELLS = torch.tensor([[[[True, False], [False, True]]]])
KINDS = {"changed": ChangedMSE, "static": StaticMSE, "moving": MovingMSE, "entering": EnteringMSE}


@pytest.mark.parametrize("kind", KINDS)
def test_by_hand(kind: str) -> None:
    metric: HorizonMetric = KINDS[kind](1)
    others = dict.fromkeys(KINDS.keys() - {kind}, ~CELLS)
    metric.update(FORECAST, TARGET, **{kind: CELLS}, **others)
    metric.update(FORECAST, TARGET)  # not told: does not count
    assert metric.compute().mean.item() == pytest.approx((0.16 + 0.09) / 2)
    assert math.isnan(metric.compute().per_window[1].item())
    assert metric.name == f"mse_{kind}_cells"


def test_normalised_by_all_cells() -> None:
    changed, static = ChangedMSE(1, normalise="all"), StaticMSE(1, normalise="all")
    changed.update(FORECAST, TARGET, changed=CELLS, static=~CELLS)
    static.update(FORECAST, TARGET, changed=CELLS, static=~CELLS)
    assert changed.compute().mean.item() == pytest.approx((0.16 + 0.09) / 4)
    assert static.compute().mean.item() == pytest.approx((0.01 + 0.16) / 4)


def test_without_such_cells_undefined() -> None:
    assert masked_mse(FORECAST, TARGET, torch.zeros_like(CELLS)).isnan().all()


def test_misuse_is_refused() -> None:
    with pytest.raises(ValueError, match="'masked' or 'all'"):
        ChangedMSE(1, normalise="some")  # type: ignore[arg-type]
