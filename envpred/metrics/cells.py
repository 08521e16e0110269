"""A score of every cell, averaged over all cells of a grid and over those of each kind.

Dynamic and moving cells are chosen by what happened: there even a calibrated forecast looks too sure of what was likely
(the forecaster's dilemma, Lerch et al. 2017), so such numbers compare forecasts and judge none.  Entering cells follow
from where the ego went, whatever was found in them.
"""

from abc import abstractmethod

import torch
from torch import Tensor

from envpred.metrics.changed_cells import changed, told
from envpred.metrics.windows import Judged, PerHorizon, WindowMetric, summarise

KINDS = ("dynamic", "moving", "entering")


def key_of(name: str, kind: str) -> str:
    """Key of the metric `name` in a result, over cells of a `kind`: `brier_moving_cells`."""
    return f"{name}_{kind}_cells"


def kinds_of(judged: Judged) -> Tensor:
    """The cells of KINDS (3, B, N, H, W) bool; a kind that is not told has none."""
    target, last = judged.target, judged.last
    dynamic = changed(target, last) & ~last.isnan()[:, None]
    return torch.stack([dynamic, told(judged.moving, target), told(judged.entering, target)])


def means(values: Tensor, counted: Tensor) -> Tensor:
    """Mean of `values` (B, N, H, W) over the cells that are `counted` (same shape, bool): (B, N), NaN without any."""
    return (values * counted).sum((-2, -1)) / counted.sum((-2, -1))


class KindsMetric(WindowMetric):
    """Base of metrics that have a value over all cells, by `name`, and one over the cells of each kind."""

    needs_cells = True

    @abstractmethod
    def judge(self, judged: Judged) -> Tensor:
        """(B, width) of all that is told of a batch."""

    def measure(self, forecast: Tensor, target: Tensor, last: Tensor) -> Tensor:
        return self.judge(Judged(forecast, target, last))

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
        kinds = [counted, *(counted & kind for kind in kinds_of(judged))]
        return torch.stack([means(scores, kind) for kind in kinds], dim=1).flatten(1)

    def compute(self) -> dict[str, PerHorizon]:
        """Over all windows seen in all processes."""
        index, values = self.rows()
        kinds = values.view(-1, 1 + len(KINDS), self.horizons).unbind(1)
        return {
            name: summarise(kind, index, self.about._replace(title=title), skip_undefined=True)
            for name, title, kind in zip(self.outputs, self.titles, kinds, strict=True)
        }
