"""Squared error where the scene changes and where it does not."""

from abc import abstractmethod
from typing import Any, Literal

from torch import Tensor

from envpred.metrics.outcome import occupied
from envpred.metrics.windows import HorizonMetric

Normalise = Literal["masked", "all"]


def changed(target: Tensor, last: Tensor) -> Tensor:
    """Dynamic cells (B, N, H, W): occupied in one and not in the other of `target` (B, N, H, W), `last` (B, H, W)."""
    return occupied(target) != occupied(last)[:, None]


def masked_mse(forecast: Tensor, target: Tensor, mask: Tensor, normalise: Normalise = "masked") -> Tensor:
    """Sum of (forecast - target)^2 over the cells of `mask` (B, N, H, W): (B, N).

    The literature divides in two ways that differ by orders of magnitude: by the number of `masked` cells, the mean
    error of such a cell (ours; NaN where there is none), or by the number of `all` cells of the grid.
    """
    total = ((forecast - target).square() * mask).sum((-2, -1))
    return total / (mask.sum((-2, -1)) if normalise == "masked" else mask[0, 0].numel())


class _MaskedMSE(HorizonMetric):
    unit = "× 10⁻³"
    digits = 1
    factor = 1e3
    direction = "lower"
    higher_is_better = False
    needs_last = True
    skip_undefined = True

    def __init__(self, horizons: int = 15, normalise: Normalise = "masked", **kwargs: Any) -> None:
        super().__init__(horizons, **kwargs)
        if normalise not in ("masked", "all"):
            raise ValueError(f"normalise is 'masked' or 'all', not {normalise!r}")
        self.normalise = normalise

    @abstractmethod
    def mask(self, target: Tensor, last: Tensor) -> Tensor:
        """Cells (B, N, H, W) that count."""

    def measure(self, forecast: Tensor, target: Tensor, last: Tensor) -> Tensor:
        return masked_mse(forecast, target, self.mask(target, last), self.normalise)


class DynamicMSE(_MaskedMSE):
    """Mean squared error over the dynamic cells: those whose occupancy differs from the last grid shown.

    The ego's motion makes cells change as well as movers do, since grids move with the ego.  A window without a dynamic
    cell at a horizon does not count there.

    >>> import torch
    >>> last, target = torch.zeros(1, 2, 2), torch.tensor([[[[1.0, 0.0], [0.0, 0.0]]]])
    >>> metric = DynamicMSE(horizons=1)
    >>> metric.update(torch.full_like(target, 0.5), target, last)
    >>> metric.compute().mean.item()
    0.25
    """

    name = "mse_dynamic_cells"
    title = "MSE, dynamic cells"

    def mask(self, target: Tensor, last: Tensor) -> Tensor:
        return changed(target, last)


class StaticMSE(_MaskedMSE):
    """Mean squared error over the static cells: those whose occupancy is that of the last grid shown.

    >>> import torch
    >>> last, target = torch.zeros(1, 2, 2), torch.tensor([[[[1.0, 0.0], [0.0, 0.0]]]])
    >>> metric = StaticMSE(horizons=1)
    >>> metric.update(torch.tensor([[[[0.5, 0.3], [0.0, 0.0]]]]), target, last)
    >>> round(metric.compute().mean.item(), 4)
    0.03
    """

    name = "mse_static_cells"
    title = "MSE, static cells"

    def mask(self, target: Tensor, last: Tensor) -> Tensor:
        return ~changed(target, last)
