"""The best of k samples."""

from itertools import pairwise

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from envpred.metrics.best_of_k import BestOfK
from envpred.metrics.horizon_mse import horizon_mse


def best(samples: Tensor | None, forecast: Tensor, target: Tensor, k: int, **kinds: Tensor) -> dict[str, list[float]]:
    metric = BestOfK(target.shape[1], k)
    metric.update(forecast, target, torch.zeros_like(target[:, 0]), samples=samples, **kinds)
    return {name: found.mean.tolist() for name, found in metric.compute().items()}


def test_one_sample_is_chosen_for_all_of_a_window() -> None:
    """The second is best at the second horizon and in the moving cell, but the first is over all."""
    samples = torch.tensor([[[0.1, 0.1], [0.2, 0.2]], [[0.6, 0.0], [0.0, 0.0]]]).view(1, 2, 2, 1, 2)
    target = torch.zeros(1, 2, 1, 2)
    moving = torch.tensor([False, True]).expand(1, 2, 1, 2)
    found = best(samples, samples.mean(1), target, 2, moving=moving)
    assert found["mse_best_of_k"] == pytest.approx([0.01, 0.04])
    assert found["mse_best_of_k_moving_cells"] == pytest.approx([0.01, 0.04])


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 6))
def test_never_above_the_mean_of_the_samples_errors(seed: int, K: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    samples, target = torch.rand(1, K, 3, 4, 4, generator=generator), torch.rand(1, 3, 4, 4, generator=generator)
    errors = torch.stack([horizon_mse(samples[:, k], target).mean() for k in range(K)])
    found = [sum(best(samples, samples.mean(1), target, k)["mse_best_of_k"]) / 3 for k in range(1, K + 1)]
    assert found[-1] == pytest.approx(errors.min().item(), rel=1e-5)
    assert found[-1] <= errors.mean().item() + 1e-6
    assert all(more <= fewer + 1e-7 for fewer, more in pairwise(found))


def test_the_same_k_for_everybody() -> None:
    generator = torch.Generator().manual_seed(0)
    samples, target = torch.rand(1, 4, 2, 3, 3, generator=generator), torch.rand(1, 2, 3, 3, generator=generator)
    forecast = samples.mean(1)
    own = horizon_mse(forecast, target)[0].tolist()
    assert best(None, forecast, target, 3)["mse_best_of_k"] == pytest.approx(own)
    same = forecast[:, None].expand_as(samples)
    assert best(same, forecast, target, 3)["mse_best_of_k"] == pytest.approx(own)
    three = best(samples[:, :3], forecast, target, 3)["mse_best_of_k"]
    samples[:, 3] = target  # a fourth is not looked at
    assert best(samples, forecast, target, 3)["mse_best_of_k"] == pytest.approx(three)
    assert torch.tensor(best(samples, forecast, target, 5)["mse_best_of_k"]).isnan().all()
    with pytest.raises(ValueError, match="best of 0"):
        BestOfK(1, 0)
