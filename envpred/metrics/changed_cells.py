"""Squared error where the scene changes and where it does not, where something moves, and where the view is new."""

from typing import Any, Literal

from torch import Tensor

from envpred.metrics.cells import means
from envpred.metrics.outcome import as_float
from envpred.metrics.windows import HorizonMetric, Judged

Normalise = Literal["masked", "all"]


def masked_mse(forecast: Tensor, target: Tensor, mask: Tensor, normalise: Normalise = "masked") -> Tensor:
    """Sum of (forecast - target)^2 over the cells of `mask` (B, N, H, W): (B, N).

    The literature divides in two ways that differ by orders of magnitude: by the number of `masked` cells, the mean
    error of such a cell (ours; NaN where there is none), or by the number of `all` cells of the grid.
    """
    squares = (forecast - target).square_()
    return means(squares, mask) if normalise == "masked" else (squares * as_float(mask)).mean((-2, -1))


class _MaskedMSE(HorizonMetric):
    unit = "× 10⁻³"
    digits = 1
    factor = 1e3
    direction = "lower"
    higher_is_better = False
    skip_undefined = True
    needs_cells = True

    def __init__(self, horizons: int = 15, normalise: Normalise = "masked", **kwargs: Any) -> None:
        super().__init__(horizons, **kwargs)
        if normalise not in ("masked", "all"):
            raise ValueError(f"normalise is 'masked' or 'all', not {normalise!r}")
        self.normalise = normalise

    def over(self, cells: Tensor, judged: Judged) -> Tensor:
        """(B, N) over `cells` (B, N, H, W)."""
        return masked_mse(judged.forecast, judged.target, cells, self.normalise)


class ChangedMSE(_MaskedMSE):
    """Mean squared error over the cells that have changed since the last frame shown, as `update` is told them.

    A window without such a cell at a horizon does not count there, here and in the other kinds.

    >>> import torch
    >>> target = torch.tensor([[[[1.0, 0.0], [0.0, 0.0]]]])
    >>> metric = ChangedMSE(horizons=1)
    >>> metric.update(torch.full_like(target, 0.5), target, changed=target > 0)
    >>> metric.compute().mean.item()
    0.25
    """

    name = "mse_changed_cells"
    title = "MSE, changed cells"
    rewards = "Rewards foreseeing where things come and go, and a forecast that is unsure of everything."

    def judge(self, judged: Judged) -> Tensor:
        return self.over(judged.changed, judged)


class StaticMSE(_MaskedMSE):
    """Mean squared error over the cells that were measured to be the same as in the last frame shown, as told.

    >>> import torch
    >>> target = torch.tensor([[[[1.0, 0.0], [0.0, 0.0]]]])
    >>> metric = StaticMSE(horizons=1)
    >>> metric.update(torch.tensor([[[[0.5, 0.3], [0.0, 0.0]]]]), target, static=target == 0)
    >>> round(metric.compute().mean.item(), 4)
    0.03
    """

    name = "mse_static_cells"
    title = "MSE, static cells"
    rewards = "Rewards keeping what stands still, moved with the ego, and a forecast that nothing changes."

    def judge(self, judged: Judged) -> Tensor:
        return self.over(judged.static, judged)


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
    rewards = "Rewards carrying movers on to where they are found, within a metre of them."

    def judge(self, judged: Judged) -> Tensor:
        return self.over(judged.moving, judged)


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
    rewards = "Rewards a good guess of what comes into view, of which nothing was seen."

    def judge(self, judged: Judged) -> Tensor:
        return self.over(judged.entering, judged)
