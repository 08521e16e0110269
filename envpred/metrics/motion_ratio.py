"""Motion ratio: how much a forecast moves compared with what moves."""

from torch import Tensor

from envpred.metrics.windows import HorizonMetric


def motion_ratio(forecast: Tensor, target: Tensor, last: Tensor) -> Tensor:
    """Sum |forecast - last| / sum |target - last| over the cells: (B, N) of (B, N, H, W) and `last` (B, H, W).

    NaN where the target does not move.
    """
    last = last[:, None]
    moved, moves = (forecast - last).abs().sum((-2, -1)), (target - last).abs().sum((-2, -1))
    return moved / moves.where(moves > 0, float("nan"))


class MotionRatio(HorizonMetric):
    """Change of the forecast since the last grid shown over the change of the target; best at 1.

    0 is a forecast frozen at the last grid (the failure of recurrent forecasters that squared error hides, because the
    static baseline is hard to beat); a value that stays level over the horizons while the target moves on is one frozen
    at its first forecast.  Blur moves cells too: read it beside the error.

    >>> import torch
    >>> last, target = torch.zeros(1, 1, 4), torch.tensor([[[[1.0, 1.0, 0.0, 0.0]]]])
    >>> metric = MotionRatio(horizons=1)
    >>> metric.update(target / 4, target, last)
    >>> metric.compute().mean.item()
    0.25
    """

    title = "Motion ratio"
    digits = 2
    direction = 1.0
    higher_is_better = None
    needs_last = True
    rewards = "Rewards moving as much as the scene does, in the right place or not, by blur too."
    skip_undefined = True

    def measure(self, forecast: Tensor, target: Tensor, last: Tensor) -> Tensor:
        return motion_ratio(forecast, target, last)
