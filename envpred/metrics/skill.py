"""Skill: how much of a reference's error a forecast avoids, on the same windows."""

import torch
from torch import Tensor

from envpred.metrics.about import About
from envpred.metrics.horizon_mse import horizon_mse
from envpred.metrics.ratios import Ratio, ratio_of_means
from envpred.metrics.windows import PerHorizon, WindowMetric

ABOUT = About("Skill", "", 3, 1.0, "higher")


def skill(mse: Tensor, reference: Tensor, about: About = ABOUT) -> Ratio:
    """Skill of per-window errors `mse` (W, N) against the `reference`'s (W, N) on the same windows, row by row.

    1 - mean(mse) / mean(reference): 1 is perfect, 0 no better, below 0 worse (the mean squared error skill score,
    Murphy 1988).  The standard error is that of a ratio of means (delta method).  A reference without error gives NaN
    or -inf.
    """
    if mse.shape != reference.shape or mse.ndim != 2:
        raise ValueError(f"mse {tuple(mse.shape)} and reference {tuple(reference.shape)} must both be (W, N)")
    ratio, error = ratio_of_means(mse, reference)
    return Ratio(1 - ratio, error, about)


def skill_against(result: PerHorizon, reference: PerHorizon) -> Ratio:
    """Skill of one run's MSE against another's; a ValueError unless both saw the very same windows."""
    if not torch.equal(result.index, reference.index):
        raise ValueError("skill compares errors on the same windows, but the two results saw different ones")
    return skill(result.per_window, reference.per_window)


class StaticSkill(WindowMetric):
    """Skill against the static baseline (the last grid shown stands for every horizon), per horizon.

    >>> metric = StaticSkill(horizons=1)
    >>> target, forecast, last = torch.ones(2, 1, 4, 4), torch.full((2, 1, 4, 4), 0.9), torch.full((2, 4, 4), 0.8)
    >>> metric.update(forecast, target, last)
    >>> round(metric.compute().value.item(), 4)
    0.75
    """

    name = "skill"
    title = "Skill against the static baseline"
    direction = "higher"
    higher_is_better = True
    needs_last = True
    rewards = "Rewards less squared error than keeping the last grid shown; the same order as MSE on the same windows."

    @property
    def width(self) -> int:
        return 2 * self.horizons

    def measure(self, forecast: Tensor, target: Tensor, last: Tensor) -> Tensor:
        return torch.cat([horizon_mse(forecast, target), horizon_mse(last[:, None], target)], dim=1)

    def compute(self) -> Ratio:
        """Skill over all windows seen in all processes."""
        _, values = self.rows()
        return skill(values[:, : self.horizons], values[:, self.horizons :], self.about)
