"""Brier score: squared error of the probability against what was measured, not against another probability."""

from torch import Tensor

from envpred.metrics.cells import CellMetric, means
from envpred.metrics.outcome import as_float, measured, occupied
from envpred.metrics.windows import Judged


def brier(forecast: Tensor, label: Tensor) -> Tensor:
    """Mean over the measured cells of (forecast - outcome)^2: (B, N) of (B, N, H, W); NaN where none is measured."""
    return means(_squares(forecast, label), measured(label))


def _squares(forecast: Tensor, label: Tensor) -> Tensor:
    return (forecast - as_float(occupied(label))).square_()


class Brier(CellMetric):
    """Brier score (Brier 1950) over the cells measured in the target frame; the outcome is 1 where occupied, else 0.

    >>> import torch
    >>> metric = Brier(horizons=1)
    >>> forecast, label = torch.tensor([[[[0.9, 0.2, 0.7]]]]), torch.tensor([[[[1, 2, 0]]]], dtype=torch.uint8)
    >>> metric.update(forecast, forecast, label=label, moving=label == 1)
    >>> round(metric.compute()["brier"].mean.item(), 4)  # (0.01 + 0.04) / 2; the third cell was not measured
    0.025
    >>> round(metric.compute()["brier_moving_cells"].mean.item(), 4)
    0.01
    """

    title = "Brier score"
    direction = "lower"
    higher_is_better = False
    rewards = "Rewards honest probabilities: its best is the true frequency, neither surer nor less sure."
    needs_label = True

    def scores(self, judged: Judged) -> Tensor:
        return _squares(judged.forecast, judged.label)

    def counted(self, judged: Judged) -> Tensor:
        return measured(judged.label)
