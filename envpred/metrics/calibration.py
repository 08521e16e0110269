"""Calibration: of the cells forecast at 70 %, are 70 % occupied?"""

from typing import Any

import torch
from torch import Tensor

from envpred.metrics.cells import KINDS, key_of, kinds_of
from envpred.metrics.outcome import histograms
from envpred.metrics.windows import Judged, PerHorizon, WindowMetric, summarise, without_nan

PARTS = 3  # of a bin: number of cells, sum of their forecasts, number of them occupied


def reliability_bins(forecast: Tensor, label: Tensor, bins: int = 10, cells: Tensor | None = None) -> Tensor:
    """Number of measured cells, sum of their forecasts and number of occupied ones per bin: (B, N, 3, bins).

    `forecast` and `label` (B, N, H, W); bin k holds forecasts in [k/bins, (k+1)/bins), the last one 1 as well.  With
    kinds of `cells` (kinds, B, N, H, W), which may overlap: (kinds, B, N, 3, bins).
    """
    kinds = 0 if cells is None else len(cells)
    sets = 2**kinds
    place = (forecast * bins).int().clamp_(0, bins - 1)
    for n in range(kinds):  # [kinds that a cell is of, bin]
        assert cells is not None
        place += cells[n].int() * (2**n * bins)
    free, full = histograms(place, label, sets * bins)
    free_sums, full_sums = histograms(place, label, sets * bins, forecast)
    shape = (*forecast.shape[:2], sets, bins)
    parts = torch.stack([part.view(shape) for part in (free + full, free_sums + full_sums, full)], dim=3).float()
    if cells is None:
        return parts[:, :, 0]
    of = [[k for k in range(sets) if k >> n & 1] for n in range(kinds)]
    return torch.stack([parts[:, :, members].sum(2) for members in of])


def expected_calibration_error(parts: Tensor) -> Tensor:
    """Mean over cells of |mean forecast - occupied share| of the cell's bin: (...) of `parts` (..., 3, bins).

    Naeini, Cooper, Hauskrecht 2015, equation 3, with equal bins of the forecast probability.  NaN without cells.
    """
    count, forecast, full = parts.double().unbind(-2)
    return (forecast - full).abs().sum(-1) / count.sum(-1)


class Reliability:
    """A reliability diagram per horizon: `count`, mean `forecast` and `occupied` share of each bin, all (N, bins).

    `ece` (N,) is the expected calibration error over all windows taken together.  NaN in empty bins.
    """

    def __init__(self, parts: Tensor) -> None:
        self.count, forecast, full = parts.double().unbind(-2)
        self.forecast, self.occupied = forecast / self.count, full / self.count
        self.ece = expected_calibration_error(parts)

    def as_json(self) -> dict[str, Any]:
        """Lists for a result file, None where a bin is empty."""
        return {"ece": without_nan(self.ece.tolist())} | {
            name: [without_nan(row) for row in values.tolist()]
            for name, values in (("count", self.count), ("forecast", self.forecast), ("occupied", self.occupied))
        }


class Calibration(WindowMetric):
    """Expected calibration error (`ece`, of each window) and reliability diagram (`reliability`, of all), per horizon.

    Over the cells measured in the target frame, and the error over those of each kind as well (`ece_entering_cells`,
    see `envpred.metrics.cells`).  The error of one window is above that of all windows together, since errors of
    opposite sign no longer cancel.

    >>> import torch
    >>> metric = Calibration(horizons=1)
    >>> forecast, label = torch.full((1, 1, 1, 4), 0.75), torch.tensor([[[[1, 1, 2, 2]]]], dtype=torch.uint8)
    >>> metric.update(forecast, forecast, label=label)
    >>> metric.compute()["ece"].mean.item()
    0.25
    """

    title = "Calibration error"
    direction = "lower"
    higher_is_better = False
    rewards = "Rewards probabilities that mean what they say; saying the mean everywhere is enough."
    needs_label = True
    needs_cells = True

    def __init__(self, horizons: int = 15, bins: int = 10, **kwargs: Any) -> None:
        super().__init__(horizons, **kwargs)
        self.bins = bins

    @property
    def outputs(self) -> tuple[str, ...]:
        return ("ece", "reliability", *(key_of("ece", kind) for kind in KINDS))

    @property
    def width(self) -> int:
        return (1 + len(KINDS)) * self.horizons * PARTS * self.bins

    def judge(self, judged: Judged) -> Tensor:
        every = torch.ones_like(judged.target, dtype=torch.bool)[None]
        kinds = torch.cat([every, kinds_of(judged)])
        return reliability_bins(judged.forecast, judged.label, self.bins, kinds).transpose(0, 1).flatten(1)

    def compute(self) -> dict[str, PerHorizon | Reliability]:
        """Over all windows seen in all processes."""
        index, values = self.rows()
        every, *kinds = values.view(-1, 1 + len(KINDS), self.horizons, PARTS, self.bins).double().unbind(1)
        found: dict[str, PerHorizon | Reliability] = {
            "ece": summarise(expected_calibration_error(every), index, self.about, skip_undefined=True),
            "reliability": Reliability(every.sum(0)),
        }
        for kind, parts in zip(KINDS, kinds, strict=True):
            about = self.about._replace(title=f"{self.title}, {kind} cells")
            found[key_of("ece", kind)] = summarise(expected_calibration_error(parts), index, about, skip_undefined=True)
        return found
