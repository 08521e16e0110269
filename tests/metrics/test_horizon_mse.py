"""Mean squared error per horizon."""

import torch

from envpred.metrics.horizon_mse import HorizonMSE, horizon_mse


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
