"""Overlap of the cells forecast as occupied with those that were: IoU, precision, recall at 0.5."""

from torch import Tensor

from envpred.metrics.outcome import occupied
from envpred.metrics.windows import HorizonMetric


def overlap(forecast: Tensor, target: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Number of cells (B, N) occupied (> 0.5) in both, in `forecast`, and in `target` (B, N, H, W)."""
    said, was = occupied(forecast), occupied(target)
    return (said & was).sum((-2, -1)), said.sum((-2, -1)), was.sum((-2, -1))


class IoU(HorizonMetric):
    """Intersection over union of the occupied cells (Jaccard index) at 0.5; a window without any does not count.

    >>> import torch
    >>> metric = IoU(horizons=1)
    >>> metric.update(torch.tensor([[[[0.9, 0.8, 0.1]]]]), torch.tensor([[[[0.9, 0.1, 0.9]]]]))
    >>> round(metric.compute().mean.item(), 4)
    0.3333
    """

    name = "iou"
    title = "IoU at 0.5"
    direction = "higher"
    higher_is_better = True
    skip_undefined = True

    def measure(self, forecast: Tensor, target: Tensor, last: Tensor) -> Tensor:
        both, said, was = overlap(forecast, target)
        return both / (said + was - both)


class Precision(HorizonMetric):
    """Share of the cells forecast as occupied that were; a window where none is forecast does not count.

    >>> import torch
    >>> metric = Precision(horizons=1)
    >>> metric.update(torch.tensor([[[[0.9, 0.8, 0.1]]]]), torch.tensor([[[[0.9, 0.1, 0.9]]]]))
    >>> metric.compute().mean.item()
    0.5
    """

    title = "Precision at 0.5"
    direction = "higher"
    higher_is_better = True
    skip_undefined = True

    def measure(self, forecast: Tensor, target: Tensor, last: Tensor) -> Tensor:
        both, said, _ = overlap(forecast, target)
        return both / said


class Recall(HorizonMetric):
    """Share of the occupied cells that were forecast as such; a window without any does not count.

    >>> import torch
    >>> metric = Recall(horizons=1)
    >>> metric.update(torch.tensor([[[[0.9, 0.8, 0.1, 0.6]]]]), torch.tensor([[[[0.9, 0.1, 0.1, 0.9]]]]))
    >>> metric.compute().mean.item()
    1.0
    """

    title = "Recall at 0.5"
    direction = "higher"
    higher_is_better = True
    skip_undefined = True

    def measure(self, forecast: Tensor, target: Tensor, last: Tensor) -> Tensor:
        both, _, was = overlap(forecast, target)
        return both / was
