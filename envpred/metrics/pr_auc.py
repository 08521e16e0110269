"""Area under the precision-recall curve, as the Waymo occupancy and flow challenge computes it."""

import torch
from torch import Tensor

from envpred.metrics.outcome import OutcomeMetric, histograms
from envpred.metrics.windows import Judged

THRESHOLDS = 100


def pr_auc(forecast: Tensor, label: Tensor) -> Tensor:
    """Area under precision over recall at 100 thresholds, over the measured cells: (B, N) of (B, N, H, W).

    Thresholds lie evenly in [0, 1], the first just below and the last just above; between two of them the number of
    true positives grows in proportion to that of the cells said to be occupied, so that precision follows a curve, and
    a straight line would say too much (Davis and Goadrich 2006).  That is `tf.keras.metrics.AUC` with 100 thresholds,
    curve PR and interpolation, which the challenge takes (Mahjourian et al. 2022).  NaN where no measured cell is
    occupied.
    """
    last = THRESHOLDS - 1
    # The number of thresholds, the first left out, that a forecast is above: strictly, as theirs.
    above = ((forecast * last).ceil().int() - 1).clamp_(0, last - 1)
    free, full = histograms(above, label, last)
    said, true = (_at_thresholds(counts) for counts in (free + full, full))
    more_said, more_true = said[..., :-1] - said[..., 1:], true[..., :-1] - true[..., 1:]
    slope = more_true / more_said.clamp(min=1)
    start = true[..., 1:] - slope * said[..., 1:]
    growth = torch.where(said[..., 1:] > 0, said[..., :-1] / said[..., 1:].clamp(min=1), 1.0)
    return ((slope * (more_true + start * growth.log())).sum(-1) / full.sum(-1)).float()


def _at_thresholds(counts: Tensor) -> Tensor:
    """Number of cells (B, N, 100) above each threshold, of `counts` (B, N, 99) by the highest that they are above."""
    return torch.cat([counts.flip(-1).cumsum(-1).flip(-1), torch.zeros_like(counts[..., :1])], dim=-1)


class PrAuc(OutcomeMetric):
    """Area under the precision-recall curve (Mahjourian et al. 2022); by chance it is the share of occupied cells.

    >>> import torch
    >>> metric = PrAuc(horizons=1)
    >>> forecast, label = torch.tensor([[[[0.9, 0.6, 0.3, 0.1]]]]), torch.tensor([[[[1, 2, 1, 2]]]], dtype=torch.uint8)
    >>> metric.update(forecast, forecast, label=label)
    >>> round(metric.compute().mean.item(), 4)  # 1/2 for the first, (1 - log(3/2)) / 2 for the third
    0.7973
    """

    title = "Precision-recall area"
    rewards = "Rewards ranking occupied cells first, whatever the numbers; easy free cells do not lift it."

    def judge(self, judged: Judged) -> Tensor:
        return pr_auc(judged.forecast, judged.label)
