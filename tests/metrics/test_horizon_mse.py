"""Mean squared error per horizon."""

import pytest
import torch

from envpred.metrics.horizon_mse import HorizonMSE, MassMSE, horizon_mse


def test_by_hand() -> None:
    target = torch.zeros(1, 2, 2, 2)
    forecast = torch.tensor([[[[0.0, 0.2], [0.4, 0.0]], [[1.0, 1.0], [1.0, 0.0]]]])
    # horizon 1: (0.04 + 0.16)/4 = 0.05; horizon 2: 3/4
    torch.testing.assert_close(horizon_mse(forecast, target), torch.tensor([[0.05, 0.75]]))


def test_half_precision_forecasts_are_compared_in_float32() -> None:
    target = torch.full((1, 1, 8, 8), 0.3)
    metric = HorizonMSE(1)
    metric.update(target.bfloat16(), target)
    difference = target.bfloat16().float() - target
    torch.testing.assert_close(metric.compute().mean[0].float(), difference[0, 0, 0, 0] ** 2)


def test_a_forecast_of_nan_is_not_hidden() -> None:
    target = torch.zeros(2, 1, 2, 2)
    forecast = target.clone()
    forecast[0, 0, 0, 0] = float("nan")
    metric = HorizonMSE(1)
    metric.update(forecast, target)
    assert metric.compute().mean.isnan().all()


def test_against_the_mass_of_occupied() -> None:
    """A cell of which nothing is known: the particle filter's 0 is right there, and half is not."""
    target, mass = torch.tensor([[[[0.5, 0.8]]]]), torch.tensor([[[[0.0, 0.6]]]])
    for forecast, error in ((torch.tensor([[[[0.0, 0.6]]]]), 0.0), (target, (0.25 + 0.04) / 2)):
        metric = MassMSE(1)
        metric.update(forecast, target, mass=mass)
        torch.testing.assert_close(metric.compute().mean, torch.tensor([error]).double())


def test_without_a_mass_it_is_undefined_and_another_grid_is_refused() -> None:
    metric, target = MassMSE(1), torch.rand(1, 1, 4, 4)
    metric.update(target, target)
    assert metric.compute().mean.isnan().all()
    with pytest.raises(ValueError, match=r"mass \(1, 1, 2, 4\) must be \(1, 1, 4, 4\)"):
        metric.update(target, target, mass=target[:, :, :2])
