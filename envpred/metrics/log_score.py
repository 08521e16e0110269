"""Log score: how surprised a forecast is by what was measured."""

from torch import Tensor

from envpred.metrics.cells import CellMetric, means
from envpred.metrics.outcome import as_float, measured, occupied
from envpred.metrics.windows import Judged

SMOOTHING = 0.01


def log_score(forecast: Tensor, label: Tensor) -> Tensor:
    """Mean over the measured cells of -log of the probability of what was measured: (B, N) of (B, N, H, W), in nats.

    A probability p counts as s + (1 - 2 s) p with s = 0.01, or one sure cell that is wrong would cost infinitely much
    and decide alone.  NaN where none is measured.
    """
    return means(_surprise(forecast, label), measured(label))


def _surprise(forecast: Tensor, label: Tensor) -> Tensor:
    missed = (forecast - as_float(occupied(label))).abs_()  # 1 - the probability of what was measured
    return missed.mul_(2 * SMOOTHING - 1).add_(1 - SMOOTHING).log_().neg_()


class LogScore(CellMetric):
    """Log score (Good 1952; ignorance, Roulston and Smith 2002), smoothed by 0.01; 0.69 says nothing of any cell.

    >>> import torch
    >>> metric = LogScore(horizons=1)
    >>> forecast, label = torch.tensor([[[[0.5, 0.0, 0.7]]]]), torch.tensor([[[[1, 1, 0]]]], dtype=torch.uint8)
    >>> metric.update(forecast, forecast, label=label)
    >>> round(metric.compute()["log_score"].mean.item(), 4)  # (-log(0.5) - log(0.01)) / 2; the third was not measured
    2.6492
    """

    title = f"Log score, smoothed by {SMOOTHING}"
    direction = "lower"
    higher_is_better = False
    needs_label = True
    rewards = "Rewards honest probabilities, and punishes sure mistakes far more than the Brier score does."

    def scores(self, judged: Judged) -> Tensor:
        return _surprise(judged.forecast, judged.label)

    def counted(self, judged: Judged) -> Tensor:
        return measured(judged.label)
