"""Fractions skill score."""

import numpy as np
import pytest
import torch

from envpred.mapping.geometry import FREE, OCCUPIED, UNKNOWN
from envpred.metrics.fractions_skill import FractionsSkill, fractions_skill


def by_definition(forecast: torch.Tensor, label: torch.Tensor, cells: int) -> float:
    """Neighbourhood by neighbourhood, of one grid (H, W)."""
    known = ((label == OCCUPIED) | (label == FREE)).numpy()
    p, y, reach = forecast.numpy(), (label == OCCUPIED).numpy(), cells // 2
    apart = whole = 0.0
    for i, j in np.argwhere(known):
        near = np.s_[max(i - reach, 0) : i + reach + 1, max(j - reach, 0) : j + reach + 1]
        f, o = p[near][known[near]].mean(), y[near][known[near]].mean()
        apart, whole = apart + (f - o) ** 2, whole + f**2 + o**2
    return float(1 - apart / whole)


@pytest.mark.parametrize("cells", [1, 3, 5])
def test_equals_its_definition(cells: int) -> None:
    generator = torch.Generator().manual_seed(4)
    forecast = torch.rand(2, 2, 7, 9, generator=generator)
    label = torch.randint(0, 4, forecast.shape, generator=generator, dtype=torch.uint8)
    found = fractions_skill(forecast, label, cells)
    for b in range(2):
        for n in range(2):
            expected = by_definition(forecast[b, n], label[b, n], cells)
            assert found[b, n].item() == pytest.approx(expected, abs=1e-5)


def test_a_near_miss_is_no_miss() -> None:
    """One cell beside the place: nothing of it is right cell by cell; as wide as a car it is nearly right."""
    label = torch.full((1, 1, 16, 16), FREE, dtype=torch.uint8)
    label[..., 8, 8] = OCCUPIED
    near, far = torch.zeros(2, 1, 1, 16, 16)
    near[..., 8, 9] = far[..., 8, 15] = 1.0
    assert fractions_skill(near, label, 1).item() == 0
    # 20 of 25 neighbourhoods hold both, five the one or the other alone
    assert fractions_skill(near, label, 5).item() == pytest.approx(20 / 25)
    assert fractions_skill(far, label, 5).item() == pytest.approx(0, abs=1e-6)
    assert fractions_skill((label == OCCUPIED).float(), label).item() == 1


def test_what_was_not_measured_is_no_neighbour() -> None:
    label = torch.tensor([[[[OCCUPIED, UNKNOWN, FREE]]]], dtype=torch.uint8)
    quiet, loud = (torch.tensor([[[[0.5, p, 0.0]]]]) for p in (0.0, 1.0))
    assert fractions_skill(quiet, label, 3).item() == fractions_skill(loud, label, 3).item() == pytest.approx(0.8)


def test_windows_with_nothing_occupied_do_not_count_and_sides_are_odd() -> None:
    metric = FractionsSkill(1, cells=3)
    nothing = torch.zeros(1, 1, 4, 4)
    metric.update(nothing, nothing, label=torch.full_like(nothing, FREE, dtype=torch.uint8))
    assert metric.compute().per_window.isnan().all()
    assert metric.compute().about.title == "Fractions skill, 3 × 3 cells"
    with pytest.raises(ValueError, match="an odd number of cells a side, not 4"):
        FractionsSkill(1, cells=4)
