"""Soft IoU: overlap of probabilities with what was measured, as the Waymo occupancy and flow challenge defines it."""

from torch import Tensor

from envpred.metrics.outcome import OutcomeMetric, as_float, measured, occupied
from envpred.metrics.windows import Judged


def soft_iou(forecast: Tensor, label: Tensor) -> Tensor:
    """sum p y / (sum p + sum y - sum p y) over the measured cells, y 1 where occupied: (B, N) of (B, N, H, W).

    NaN where nothing is occupied and nothing is said to be (Mahjourian et al. 2022).
    """
    full = as_float(occupied(label))
    both, said = (forecast * full).sum((-2, -1)), (forecast * as_float(measured(label))).sum((-2, -1))
    return both / (said + full.sum((-2, -1)) - both)


class SoftIoU(OutcomeMetric):
    """Soft IoU of each window and horizon; shown, never selected by, since it rewards overconfidence.

    Where half of the cells that look alike are occupied, it is best to say 1 of all of them.

    >>> import torch
    >>> metric = SoftIoU(horizons=1)
    >>> forecast, label = torch.tensor([[[[0.6, 0.4, 0.9]]]]), torch.tensor([[[[1, 2, 0]]]], dtype=torch.uint8)
    >>> metric.update(forecast, forecast, label=label)
    >>> round(metric.compute().mean.item(), 4)  # 0.6 / (1.0 + 1 - 0.6); the last cell was not measured
    0.4286
    """

    name = "soft_iou"
    title = "Soft IoU"
    rewards = "Rewards overconfidence, so that nothing is selected by it: 1 beats the true probability."

    def judge(self, judged: Judged) -> Tensor:
        return soft_iou(judged.forecast, judged.label)
