"""Continuous ranked probability score."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from envpred.metrics.crps import CRPS, crps


def test_by_hand() -> None:
    samples = torch.tensor([0.0, 0.2, 0.6]).view(1, 3, 1, 1, 1)
    # errors 0.5, 0.3, 0.1: mean 0.3; pairs 0.2, 0.6, 0.4 over 3 x 2
    assert crps(samples, torch.full((1, 1, 1, 1), 0.5)).item() == pytest.approx(0.3 - 0.2)


def test_it_is_the_area_between_the_distributions() -> None:
    """Many samples: the integral of (F(x) - [x >= y])^2."""
    generator = torch.Generator().manual_seed(0)
    samples, y = torch.rand(4000, generator=generator).square(), 0.3
    x = np.linspace(0, 1, 20001)
    below = np.searchsorted(np.sort(samples.numpy()), x, side="right") / len(samples)
    area = ((below - (x >= y)) ** 2).mean()
    found = crps(samples.view(1, -1, 1, 1, 1), torch.full((1, 1, 1, 1), y)).item()
    assert found == pytest.approx(area, abs=2e-4)


def test_the_number_of_samples_does_not_matter_on_average() -> None:
    """Fair (Ferro 2014): few samples of the same distribution score as many do."""
    generator = torch.Generator().manual_seed(1)
    target = torch.rand(1, 1, 300, 300, generator=generator)
    few, many = (torch.rand(1, K, 1, 300, 300, generator=generator) for K in (2, 16))
    assert crps(few, target).mean().item() == pytest.approx(1 / 6, abs=4e-3)
    assert crps(many, target).mean().item() == pytest.approx(1 / 6, abs=4e-3)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.floats(0, 1, width=32), min_size=2, max_size=8), st.floats(0, 1, width=32))
def test_order_and_shift_do_not_matter(values: list[float], y: float) -> None:
    samples, target = torch.tensor(values).view(1, -1, 1, 1, 1), torch.full((1, 1, 1, 1), y)
    found = crps(samples, target)
    torch.testing.assert_close(crps(samples.flip(1), target), found, atol=1e-6, rtol=0)
    torch.testing.assert_close(crps(samples + 0.25, target + 0.25), found, atol=1e-6, rtol=0)
    torch.testing.assert_close(crps(samples[:, :1].expand_as(samples), target), (samples[:, 0] - target).abs())


def test_without_samples_it_is_the_absolute_error() -> None:
    metric = CRPS(1)
    changed = torch.tensor([[[[True, False]]]])
    metric.update(torch.tensor([[[[0.2, 0.9]]]]), torch.tensor([[[[0.5, 0.8]]]]), changed=changed)
    result = metric.compute()
    assert result["crps"].mean.item() == pytest.approx(0.2)
    assert result["crps_changed_cells"].mean.item() == pytest.approx(0.3)


def test_samples_and_not_their_mean_are_scored() -> None:
    metric = CRPS(1)
    samples = torch.tensor([0.0, 1.0]).view(1, 2, 1, 1, 1)
    metric.update(samples.mean(1), torch.full((1, 1, 1, 1), 0.5), samples=samples)
    assert metric.compute()["crps"].mean.item() == pytest.approx(0.5 - 1 / 2)
    metric.update(samples.mean(1), torch.ones(1, 1, 1, 1), samples=samples)
    assert metric.compute()["crps"].per_window.flatten().tolist() == pytest.approx([0.0, 0.5 - 1 / 2])
