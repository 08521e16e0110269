"""A score of every cell, averaged over all cells of a grid and over those of each kind.

Changed and static cells were measured both in the last frame shown and in the target's, at the same place in the world:
occupied in one of the two alone, or the same in both.  Moving ones lie around what boxes of tracked objects say to move
where there are any, else around what has moved.  All three are chosen by what happened: there even a calibrated
forecast looks too sure of what was likely (the forecaster's dilemma, Lerch et al. 2017), so such numbers compare
forecasts and judge none.  Entering cells follow from where the ego went, whatever was found in them.
"""

from abc import abstractmethod

import torch
from torch import Tensor

from envpred.metrics.outcome import as_float
from envpred.metrics.windows import Judged, PerHorizon, WindowMetric, summarise

KINDS = ("changed", "static", "moving", "entering")  # as `Judged` names them


def key_of(name: str, kind: str) -> str:
    """Key of the metric `name` in a result, over cells of a `kind`: `brier_moving_cells`."""
    return f"{name}_{kind}_cells"


def kinds_of(judged: Judged) -> Tensor:
    """The cells of KINDS (4, B, N, H, W) bool; a kind that is not told has none."""
    return torch.stack([judged.changed, judged.static, judged.moving, judged.entering])


def means(values: Tensor, counted: Tensor) -> Tensor:
    """Mean of `values` (B, N, H, W) over the `counted` cells (..., B, N, H, W) bool: (..., B, N), NaN without any."""
    weights = as_float(counted)
    return (values * weights).sum((-2, -1)) / weights.sum((-2, -1))


class KindsMetric(WindowMetric):
    """Base of metrics that have a value over all cells, by `name`, and one over the cells of each kind."""

    needs_cells = True

    @abstractmethod
    def judge(self, judged: Judged) -> Tensor:
        """(B, width) of all that is told of a batch."""

    @property
    def outputs(self) -> tuple[str, ...]:
        return (self.name, *(key_of(self.name, kind) for kind in KINDS))

    @property
    def titles(self) -> tuple[str, ...]:
        """Titles of the outputs."""
        return (self.about.title, *(f"{self.about.title}, {kind} cells" for kind in KINDS))

    @property
    def width(self) -> int:
        return (1 + len(KINDS)) * self.horizons


class CellMetric(KindsMetric):
    """A score of every cell, averaged; `compute()` gives a `PerHorizon` for each output.

    A window without such a cell does not count there.
    """

    @abstractmethod
    def scores(self, judged: Judged) -> Tensor:
        """Scores (B, N, H, W); NaN if they are not defined."""

    def counted(self, judged: Judged) -> Tensor:
        """Cells (B, N, H, W) that count, of whatever kind; by default all."""
        return torch.ones_like(judged.target, dtype=torch.bool)

    def judge(self, judged: Judged) -> Tensor:
        scores, counted = self.scores(judged), self.counted(judged)
        kinds = torch.cat([counted[None], kinds_of(judged) & counted])
        return means(scores, kinds).transpose(0, 1).flatten(1)

    def compute(self) -> dict[str, PerHorizon]:
        """Over all windows seen in all processes."""
        index, values = self.rows()
        kinds = values.view(-1, 1 + len(KINDS), self.horizons).unbind(1)
        return {
            name: summarise(kind, index, self.about._replace(title=title), skip_undefined=True)
            for name, title, kind in zip(self.outputs, self.titles, kinds, strict=True)
        }
