"""Area under the receiver operating characteristic: does the forecast rank occupied cells above free ones?"""

from typing import Any

import torch
from torch import Tensor

from envpred.metrics.outcome import outcome
from envpred.metrics.windows import HorizonMetric


def roc_auc(forecast: Tensor, target: Tensor, bins: int = 1000) -> Tensor:
    """Probability that an occupied cell's forecast is above a free cell's, ties half: (B, N) of (B, N, H, W).

    Forecasts first fall into `bins` equal bins of [0, 1], which needs no sort and bounded memory; two forecasts of one
    bin count as tied, so the area is off by at most half the share of (occupied, free) pairs that share a bin.  Cells
    whose target is without evidence take no part; NaN where no cell, or every cell, is occupied.
    """
    pairs = forecast.shape[:2].numel()
    place = (forecast * bins).int().clamp_(0, bins - 1)
    # One histogram of all grids at once: [grid, outcome, bin]; the outcome "no evidence" is dropped.
    grid = torch.arange(pairs, dtype=torch.int32, device=forecast.device).view(*forecast.shape[:2], 1, 1)
    counts = torch.bincount(((grid * 3 + outcome(target)) * bins + place).flatten(), minlength=pairs * 3 * bins)
    free, full, _ = counts.view(*forecast.shape[:2], 3, bins).double().unbind(2)
    below = free.cumsum(-1) - free / 2  # free cells in lower bins, and half of those that tie
    return ((full * below).sum(-1) / (full.sum(-1) * free.sum(-1))).float()


class RocAuc(HorizonMetric):
    """Area under the ROC curve of each window and horizon (Hanley and McNeil 1982); 0.5 is chance, 1 perfect.

    >>> import torch
    >>> metric = RocAuc(horizons=1)
    >>> metric.update(torch.tensor([[[[0.9, 0.4, 0.6, 0.1]]]]), torch.tensor([[[[1.0, 1.0, 0.0, 0.0]]]]))
    >>> metric.compute().mean.item()  # of the four pairs one is the wrong way round
    0.75
    """

    title = "ROC area"
    direction = "higher"
    higher_is_better = True
    skip_undefined = True

    def __init__(self, horizons: int = 15, bins: int = 1000, **kwargs: Any) -> None:
        super().__init__(horizons, **kwargs)
        self.bins = bins

    def measure(self, forecast: Tensor, target: Tensor, last: Tensor) -> Tensor:
        return roc_auc(forecast, target, self.bins)
