"""Area under the receiver operating characteristic: does the forecast rank occupied cells above free ones?"""

from typing import Any

from torch import Tensor

from envpred.metrics.outcome import OutcomeMetric, histograms
from envpred.metrics.windows import Judged


def roc_auc(forecast: Tensor, label: Tensor, bins: int = 1000) -> Tensor:
    """Probability that an occupied cell's forecast is above a free cell's, ties half: (B, N) of (B, N, H, W).

    Forecasts first fall into `bins` equal bins of [0, 1], which needs no sort and bounded memory; two forecasts of one
    bin count as tied, so the area is off by at most half the share of (occupied, free) pairs that share a bin.  Cells
    that were not measured take no part; NaN where no measured cell, or every one, is occupied.
    """
    free, full = histograms((forecast * bins).int().clamp_(0, bins - 1), label, bins)
    below = free.cumsum(-1) - free / 2  # free cells in lower bins, and half of those that tie
    return ((full * below).sum(-1) / (full.sum(-1) * free.sum(-1))).float()


class RocAuc(OutcomeMetric):
    """Area under the ROC curve of each window and horizon (Hanley and McNeil 1982); 0.5 is chance, 1 perfect.

    >>> import torch
    >>> metric = RocAuc(horizons=1)
    >>> forecast, label = torch.tensor([[[[0.9, 0.4, 0.6, 0.1]]]]), torch.tensor([[[[1, 1, 2, 2]]]], dtype=torch.uint8)
    >>> metric.update(forecast, forecast, label=label)
    >>> metric.compute().mean.item()  # of the four pairs one is the wrong way round
    0.75
    """

    title = "ROC area"
    rewards = "Rewards ranking occupied cells above free ones, whatever the numbers; the many easy free cells lift it."

    def __init__(self, horizons: int = 15, bins: int = 1000, **kwargs: Any) -> None:
        super().__init__(horizons, **kwargs)
        self.bins = bins

    def judge(self, judged: Judged) -> Tensor:
        return roc_auc(judged.forecast, judged.label, self.bins)
