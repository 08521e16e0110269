"""Brier score: squared error of the probability against what happened, not against another probability."""

from torch import Tensor

from envpred.metrics.cells import CellMetric, means
from envpred.metrics.outcome import known, occupied
from envpred.metrics.windows import Judged


def brier(forecast: Tensor, target: Tensor) -> Tensor:
    """Mean over the known cells of (forecast - outcome)^2: (B, N) of (B, N, H, W); NaN where nothing is known."""
    return means(_squares(forecast, target), known(target))


def _squares(forecast: Tensor, target: Tensor) -> Tensor:
    return (forecast - occupied(target).float()).square()


class Brier(CellMetric):
    """Brier score (Brier 1950) over cells whose target has evidence; the outcome is 1 where it is occupied, else 0.

    >>> import torch
    >>> metric = Brier(horizons=1)
    >>> metric.update(torch.tensor([[[[0.9, 0.2, 0.7]]]]), torch.tensor([[[[0.8, 0.1, 0.5]]]]), torch.zeros(1, 1, 3))
    >>> round(metric.compute()["brier"].mean.item(), 4)  # (0.01 + 0.04) / 2; the third cell is unknown
    0.025
    >>> round(metric.compute()["brier_dynamic_cells"].mean.item(), 4)  # the first alone has changed
    0.01
    """

    title = "Brier score"
    direction = "lower"
    higher_is_better = False

    def scores(self, judged: Judged) -> Tensor:
        return _squares(judged.forecast, judged.target)

    def counted(self, judged: Judged) -> Tensor:
        return known(judged.target)
