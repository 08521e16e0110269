"""Fractions skill score: are there as many occupied cells in a neighbourhood as was forecast, wherever in it?"""

from typing import Any

import torch
from torch import Tensor

from envpred.metrics.about import About
from envpred.metrics.outcome import as_float, measured, occupied
from envpred.metrics.windows import HorizonMetric, Judged

CELLS = 5  # about 1.7 m, the width of a car


def fractions_skill(forecast: Tensor, label: Tensor, cells: int = CELLS) -> Tensor:
    """1 - sum (f - o)^2 / sum (f^2 + o^2) of fractions f forecast and o occupied: (B, N) of (B, N, H, W).

    Fractions are means over the measured ones of the `cells` x `cells` cells around each measured cell, of the
    probability and of the outcome; sums are over those cells.  Roberts and Lean 2008, equations 5 to 7, with
    probabilities in place of their yes and no, as Schwartz et al. 2010.  NaN where neither has any.
    """
    count = as_float(measured(label))
    around, said, was = _sums(torch.stack([count, forecast * count, as_float(occupied(label))]), cells // 2).unbind(0)
    share = count / around.clamp_(min=1)
    said, was = said.mul_(share), was.mul_(share)
    whole = said.square().sum((-2, -1)) + was.square().sum((-2, -1))
    apart = said.sub_(was).square_().sum((-2, -1))
    return (whole - apart) / whole


def _sums(grids: Tensor, reach: int) -> Tensor:
    """Sums over the cells within `reach`, in either axis, of each cell of `grids` (..., H, W); beyond them is nothing.

    Ten times as fast as `avg_pool2d`, which adds up every neighbourhood from its beginning.
    """
    for axis in (-2, -1):
        sums, side = grids.clone(), grids.shape[axis]
        for step in range(1, min(reach, side - 1) + 1):
            kept = side - step
            sums.narrow(axis, 0, kept).add_(grids.narrow(axis, step, kept))
            sums.narrow(axis, step, kept).add_(grids.narrow(axis, 0, kept))
        grids = sums
    return grids


class FractionsSkill(HorizonMetric):
    """Fractions skill score (Roberts and Lean 2008) of neighbourhoods of about 1.7 m: 1 is perfect, 0 no overlap.

    A mover forecast a cell beside its place counts against a forecast twice cell by cell, where it is not and where it
    is (the double penalty); in a neighbourhood that holds both places it hardly does.

    Args:
        horizons: steps that are forecast.
        cells: side of a neighbourhood, odd.

    >>> import torch
    >>> metric = FractionsSkill(horizons=1, cells=3)
    >>> forecast, label = torch.tensor([[[[0.0, 1.0, 0.0]]]]), torch.tensor([[[[1, 2, 2]]]], dtype=torch.uint8)
    >>> metric.update(forecast, forecast, label=label)
    >>> round(metric.compute().mean.item(), 4)  # fractions 1/2, 1/3, 1/2 and 1/2, 1/3, 0
    0.7429
    """

    title = "Fractions skill"
    direction = "higher"
    higher_is_better = True
    skip_undefined = True
    needs_label = True
    rewards = "Rewards the right number of occupied cells within a car's width, wherever in it: a near miss is no miss."

    def __init__(self, horizons: int = 15, cells: int = CELLS, **kwargs: Any) -> None:
        super().__init__(horizons, **kwargs)
        if cells < 1 or cells % 2 == 0:
            raise ValueError(f"a neighbourhood has an odd number of cells a side, not {cells}")
        self.cells = cells

    @property
    def about(self) -> About:
        return super().about._replace(title=f"{self.title}, {self.cells} × {self.cells} cells")

    def judge(self, judged: Judged) -> Tensor:
        return fractions_skill(judged.forecast, judged.label, self.cells)
