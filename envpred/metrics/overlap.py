"""Overlap of the cells forecast as occupied with those that were: IoU, precision, recall at 0.5."""

from torch import Tensor

from envpred.metrics.outcome import OutcomeMetric, measured, occupied
from envpred.metrics.windows import Judged

EVEN = 0.5  # who forecasts more than this says occupied


def overlap(forecast: Tensor, label: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Number of measured cells (B, N) occupied in both, in `forecast` (> 0.5), and by `label` (B, N, H, W)."""
    said, was = (forecast > EVEN) & measured(label), occupied(label)
    return (said & was).sum((-2, -1)), said.sum((-2, -1)), was.sum((-2, -1))


class IoU(OutcomeMetric):
    """Intersection over union of the occupied cells (Jaccard index) at 0.5, of those measured in the target frame.

    A window without any does not count.

    >>> import torch
    >>> metric = IoU(horizons=1)
    >>> forecast, label = torch.tensor([[[[0.9, 0.8, 0.1, 0.9]]]]), torch.tensor([[[[1, 2, 1, 0]]]], dtype=torch.uint8)
    >>> metric.update(forecast, forecast, label=label)
    >>> round(metric.compute().mean.item(), 4)  # the last cell was not measured
    0.3333
    """

    name = "iou"
    title = "IoU at 0.5"
    rewards = "Rewards the right side of 0.5 on the cell, however sure; a mover one cell off counts as wrong twice."

    def judge(self, judged: Judged) -> Tensor:
        both, said, was = overlap(judged.forecast, judged.label)
        return both / (said + was - both)


class Precision(OutcomeMetric):
    """Share of the measured cells forecast as occupied that were; a window where none is forecast does not count.

    >>> import torch
    >>> metric = Precision(horizons=1)
    >>> forecast, label = torch.tensor([[[[0.9, 0.8, 0.1, 0.9]]]]), torch.tensor([[[[1, 2, 1, 0]]]], dtype=torch.uint8)
    >>> metric.update(forecast, forecast, label=label)
    >>> metric.compute().mean.item()
    0.5
    """

    title = "Precision at 0.5"
    rewards = "Rewards saying occupied of few cells alone, the surest: read it beside recall."

    def judge(self, judged: Judged) -> Tensor:
        both, said, _ = overlap(judged.forecast, judged.label)
        return both / said


class Recall(OutcomeMetric):
    """Share of the cells measured to be occupied that were forecast as such; a window without any does not count.

    >>> import torch
    >>> metric = Recall(horizons=1)
    >>> forecast, label = torch.tensor([[[[0.9, 0.8, 0.1]]]]), torch.tensor([[[[1, 2, 1]]]], dtype=torch.uint8)
    >>> metric.update(forecast, forecast, label=label)
    >>> metric.compute().mean.item()
    0.5
    """

    title = "Recall at 0.5"
    rewards = "Rewards saying occupied of many cells: read it beside precision."

    def judge(self, judged: Judged) -> Tensor:
        both, _, was = overlap(judged.forecast, judged.label)
        return both / was
