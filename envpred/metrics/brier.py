"""Brier score: squared error of the probability against what happened, not against another probability."""

from torch import Tensor

from envpred.metrics.outcome import known, occupied
from envpred.metrics.windows import HorizonMetric


def brier(forecast: Tensor, target: Tensor) -> Tensor:
    """Mean over the known cells of (forecast - outcome)^2: (B, N) of (B, N, H, W); NaN where nothing is known."""
    counted = known(target)
    squares = (forecast - occupied(target).float()).square()
    return (squares * counted).sum((-2, -1)) / counted.sum((-2, -1))


class Brier(HorizonMetric):
    """Brier score (Brier 1950) over cells whose target has evidence; the outcome is 1 where it is occupied, else 0.

    >>> import torch
    >>> metric = Brier(horizons=1)
    >>> metric.update(torch.tensor([[[[0.9, 0.2, 0.7]]]]), torch.tensor([[[[0.8, 0.1, 0.5]]]]))
    >>> round(metric.compute().mean.item(), 4)  # (0.01 + 0.04) / 2; the third cell is unknown
    0.025
    """

    title = "Brier score"
    direction = "lower"
    higher_is_better = False
    skip_undefined = True

    def measure(self, forecast: Tensor, target: Tensor, last: Tensor) -> Tensor:
        return brier(forecast, target)
