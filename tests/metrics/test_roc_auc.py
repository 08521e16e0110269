"""Area under the ROC curve."""

import pytest
import torch

from envpred.metrics.roc_auc import RocAuc, roc_auc
from tests.metrics.labels import labelled


def by_pairs(forecast: torch.Tensor, target: torch.Tensor) -> float:
    """The definition: over all pairs of an occupied and a free cell."""
    full, free = forecast[target > 0.5], forecast[target < 0.5]
    above, ties = full[:, None] > free, full[:, None] == free
    return ((above.sum() + ties.sum() / 2) / above.numel()).item()


def test_by_hand() -> None:
    target = torch.tensor([[[[0.9, 0.8, 0.1, 0.2, 0.5]]]])
    forecast = torch.tensor([[[[0.9, 0.4, 0.6, 0.4, 0.0]]]])
    # (0.9 > 0.6), (0.9 > 0.4), not (0.4 > 0.6), tie: 2.5 of 4; the last cell was not measured
    assert roc_auc(forecast, labelled(target)).item() == pytest.approx(2.5 / 4)


def test_equals_its_definition_grid_by_grid() -> None:
    generator = torch.Generator().manual_seed(5)
    target = torch.randint(0, 3, (2, 3, 9, 9), generator=generator) / 2
    forecast = (torch.randint(0, 1000, target.shape, generator=generator) + 0.5) / 1000
    got = roc_auc(forecast, labelled(target))
    for b in range(2):
        for n in range(3):
            assert got[b, n].item() == pytest.approx(by_pairs(forecast[b, n], target[b, n]), abs=1e-6)


def test_forecasts_of_one_bin_tie() -> None:
    target = torch.tensor([[[[1.0, 0.0]]]])
    forecast = torch.tensor([[[[0.26, 0.27]]]])
    assert roc_auc(forecast, labelled(target), bins=4).item() == 0.5
    assert roc_auc(forecast, labelled(target), bins=1000).item() == 0.0
    metric = RocAuc(1)
    metric.update(forecast, target, label=labelled(target))
    assert metric.compute().mean.item() == 0.0


def test_bounds_are_in_the_outer_bins_and_one_sided_targets_undefined() -> None:
    target = torch.tensor([[[[1.0, 0.0]]]])
    assert roc_auc(target, labelled(target)).item() == 1.0
    assert roc_auc(torch.tensor([[[[0.9995, 0.9985]]]]), labelled(target)).item() == 1.0  # in the last two bins
    assert roc_auc(target, labelled(torch.ones_like(target))).isnan().all()
    assert roc_auc(target, labelled(torch.full_like(target, 0.5))).isnan().all()
