"""Squared error where the scene changes and where it does not, where something moves, and where the view is new."""

from abc import abstractmethod
from typing import Any, Literal

import torch
from torch import Tensor

from envpred.metrics.outcome import occupied
from envpred.metrics.windows import HorizonMetric, Judged

Normalise = Literal["masked", "all"]


def changed(target: Tensor, last: Tensor) -> Tensor:
    """Dynamic cells (B, N, H, W): occupied in one and not in the other of `target` (B, N, H, W), `last` (B, H, W)."""
    return occupied(target) != occupied(last)[:, None]


def told(cells: Tensor | None, target: Tensor) -> Tensor:
    """`cells`, or none of a grid if it is not told which."""
    return torch.zeros_like(target, dtype=torch.bool) if cells is None else cells


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
    skip_undefined = True

    def __init__(self, horizons: int = 15, normalise: Normalise = "masked", **kwargs: Any) -> None:
        super().__init__(horizons, **kwargs)
        if normalise not in ("masked", "all"):
            raise ValueError(f"normalise is 'masked' or 'all', not {normalise!r}")
        self.normalise = normalise

    @abstractmethod
    def cells(self, judged: Judged) -> Tensor:
        """Cells (B, N, H, W) that count."""

    def measure(self, forecast: Tensor, target: Tensor, last: Tensor) -> Tensor:
        return self.judge(Judged(forecast, target, last))

    def judge(self, judged: Judged) -> Tensor:
        return masked_mse(judged.forecast, judged.target, self.cells(judged), self.normalise)


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
    needs_last = True

    def cells(self, judged: Judged) -> Tensor:
        return changed(judged.target, judged.last)


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
    needs_last = True

    def cells(self, judged: Judged) -> Tensor:
        return ~changed(judged.target, judged.last)


class MovingMSE(_MaskedMSE):
    """Mean squared error over the cells around what moves, as `update` is told them; undefined where it is not.

    >>> import torch
    >>> target = torch.tensor([[[[1.0, 0.0], [0.0, 0.0]]]])
    >>> metric = MovingMSE(horizons=1)
    >>> metric.update(torch.full_like(target, 0.5), target, moving=target > 0)
    >>> metric.compute().mean.item()
    0.25
    """

    name = "mse_moving_cells"
    title = "MSE, moving cells"
    needs_cells = True

    def cells(self, judged: Judged) -> Tensor:
        return told(judged.moving, judged.target)


class EnteringMSE(_MaskedMSE):
    """Mean squared error over the cells that the last grid shown does not cover, as `update` is told them.

    >>> import torch
    >>> target = torch.tensor([[[[1.0, 0.0], [0.0, 0.0]]]])
    >>> metric = EnteringMSE(horizons=1)
    >>> metric.update(torch.full_like(target, 0.5), target, entering=target == 0)
    >>> metric.compute().mean.item()
    0.25
    """

    name = "mse_entering_cells"
    title = "MSE, entering cells"
    needs_cells = True

    def cells(self, judged: Judged) -> Tensor:
        return told(judged.entering, judged.target)
