"""Spread of samples against the skill of their mean."""

import math

import pytest
import torch

from envpred.metrics.ratios import ratio_of_means
from envpred.metrics.spread_skill import SpreadSkill, spread_and_error


def test_by_hand() -> None:
    samples = torch.tensor([0.1, 0.3, 0.8]).view(1, 3, 1, 1, 1)
    spread, error = spread_and_error(samples, torch.full((1, 1, 1, 1), 0.6))
    assert spread.item() == pytest.approx(4 / 3 * (0.09 + 0.01 + 0.16) / 2)
    assert error.item() == pytest.approx(0.04)


def ratio(samples: torch.Tensor, target: torch.Tensor, **kinds: torch.Tensor) -> dict[str, float]:
    metric = SpreadSkill(1)
    last = torch.zeros_like(target[:, 0])
    for w in range(len(target)):
        told = {name: cells[w : w + 1] for name, cells in kinds.items()}
        one = slice(w, w + 1)
        metric.update(samples[one].mean(1), target[one], last[one], torch.tensor([w]), samples=samples[one], **told)
    return {name: found.value.item() for name, found in metric.compute().items()}


@pytest.mark.parametrize("K", [2, 5, 16])
def test_a_calibrated_ensemble_has_a_ratio_of_one(K: int) -> None:
    """Target and samples of a cell are draws of one distribution, another one in every cell, whatever K is."""
    generator = torch.Generator().manual_seed(K)
    width, centre = torch.rand(2, 4, 1, 1, 60, 60, generator=generator)
    drawn = centre + width * torch.randn(4, K + 1, 1, 60, 60, generator=generator)
    half = torch.zeros(4, 1, 60, 60, dtype=torch.bool)
    half[..., :30] = True
    found = ratio(drawn[:, 1:], drawn[:, 0], entering=half)
    assert found["spread_skill"] == pytest.approx(1, abs=0.05)
    assert found["spread_skill_entering_cells"] == pytest.approx(1, abs=0.07)
    too_sure = drawn[:, 1:].mean(1, keepdim=True).lerp(drawn[:, 1:], 0.5)
    assert ratio(too_sure, drawn[:, 0])["spread_skill"] == pytest.approx(0.25, abs=0.02)


def test_chosen_by_what_happened_it_is_below_one() -> None:
    """The forecaster's dilemma: the ensemble is calibrated, the cells that have changed are not a fair sample."""
    generator = torch.Generator().manual_seed(1)
    drawn = 0.3 + 0.2 * torch.randn(1, 17, 1, 60, 60, generator=generator)
    found = ratio(drawn[:, 1:], drawn[:, 0], changed=drawn[:, 0] > 0.5)
    assert found["spread_skill"] == pytest.approx(1, abs=0.1)
    assert found["spread_skill_changed_cells"] < 0.7


def test_windows_count_together_and_those_without_such_cells_not_at_all() -> None:
    samples = torch.tensor([[0.0, 0.2], [0.0, 0.4]]).view(2, 2, 1, 1, 1)
    target = torch.tensor([0.3, 0.7]).view(2, 1, 1, 1)
    moving = torch.tensor([True, False]).view(2, 1, 1, 1)
    found = ratio(samples, target, moving=moving)
    assert found["spread_skill"] == pytest.approx(1.5 * (0.02 + 0.08) / (0.04 + 0.25))
    assert found["spread_skill_moving_cells"] == pytest.approx(1.5 * 0.02 / 0.04)
    assert math.isnan(found["spread_skill_entering_cells"])


def test_undefined_without_samples_and_of_a_single_one() -> None:
    target = torch.rand(2, 1, 4, 4)
    metric = SpreadSkill(1)
    metric.update(target, target, target[:, 0])
    metric.update(target, target, target[:, 0], samples=target[:, None])
    for found in metric.compute().values():
        assert found.as_json()["mean"] == [None]


def test_a_ratio_of_means_by_hand() -> None:
    above = torch.tensor([[1.0, 1.0], [2.0, math.nan], [3.0, 5.0]])
    below = torch.tensor([[2.0, 2.0], [6.0, 4.0], [4.0, 2.0]])
    value, error = ratio_of_means(above, below, skip_undefined=True)
    assert value.tolist() == pytest.approx([0.5, 1.5])
    # residuals 0, -1, 1 over a mean of 4; 1 - 1.5 * 2 and 5 - 1.5 * 2 over 2
    assert error.tolist() == pytest.approx([(1 / 3) ** 0.5 / 4, (8 / 2) ** 0.5 / 2])
    assert ratio_of_means(above, below)[0].isnan().tolist() == [False, True]
