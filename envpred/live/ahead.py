"""Where and when the grids of a forecast lie, and the same forecast for a later present: compensation of latency."""

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from envpred.datamodules import Forecast, Seen
from envpred.horizons import NEAR
from envpred.mapping.geometry import FloatArray, GridSpec
from envpred.mapping.shift import shifted_tensor
from envpred.models.fixed_frame import likeliest_cells

UNKNOWN = 0.5  # probability of occupied in a cell that no grid shows


class LiveForecast(NamedTuple):
    """A forecast whose grids have a place in the world and a time.

    Each grid lies around where the ego is likeliest to be then; forecasts themselves know more than that one place.

    Args:
        probability: (N, H, W) float32 probability of occupied; first axis east, second north.
        origin: (N, 2) world position in metres of the south-west corner of each grid, that of its cell (0, 0).
        stamp: (N,) seconds, on the clock of the scans.
        resolution: side of a cell in metres.
        time: of the scan that it was made after, seconds.
        delay: seconds between that scan and the present that the horizons are counted from.
        samples: (K, N, H, W) equally likely futures, if the forecaster draws some.
    """

    probability: NDArray[np.float32]
    origin: FloatArray
    stamp: FloatArray
    resolution: float
    time: float
    delay: float
    samples: NDArray[np.float32] | None = None


def steps_beyond(delay: float, period: float) -> int:
    """Horizons that must be forecast beyond those asked for, to reach as far from a present `delay` seconds later."""
    return int(np.ceil(_steps(delay, period)))


def counted_from(
    forecast: Forecast,
    seen: Seen,
    time: float,
    interval: float,
    grid: GridSpec,
    origin: FloatArray,
    horizons: int,
    delay: float = 0.0,
) -> LiveForecast:
    """The first window's `forecast`, with place and time, for a present `delay` seconds after the last frame shown.

    A moment between two horizons is interpolated: both grids are moved by whole cells to where the ego is likeliest to
    be in between, and weighed by how near they are in time.  Horizon 0 is the last frame shown.

    Args:
        forecast: of `horizons` + `steps_beyond` frames.
        seen: what it was made of.
        time: of the last frame shown, seconds.
        interval: seconds between frames.
        grid: of the forecast.
        origin: (2,) world position of lattice cell (0, 0) in metres.
        horizons: that are wanted.
        delay: seconds from the last frame shown to the present.
    """
    now = np.asarray(seen["centre_cell"][0, -1].cpu(), np.int64)
    centres = np.concatenate([now[None], likeliest_cells(seen, 0, forecast.probability.shape[1])])
    steps = np.arange(1, horizons + 1)
    ahead = _steps(delay, interval) + steps
    lower, upper = np.floor(ahead).astype(int), np.ceil(ahead).astype(int)
    share = ahead - lower  # of the later of the two horizons
    between = np.floor((1 - share)[:, None] * centres[lower] + share[:, None] * centres[upper] + 0.5).astype(np.int64)
    shown = seen["occupancy"][:1, -1]
    probability = torch.cat([shown, forecast.probability[0]])
    samples = None
    if forecast.samples is not None:
        drawn = forecast.samples[0]
        samples = torch.cat([shown.expand(len(drawn), -1, -1)[:, None], drawn], dim=1)
    if delay:
        places = list(zip(lower, upper, share, between, strict=True))
        probability = torch.stack([_between(probability, centres, *place) for place in places])
        samples = None if samples is None else torch.stack([_between(samples, centres, *p) for p in places], dim=1)
    else:
        probability, samples = probability[1:], None if samples is None else samples[:, 1:]
    corner: FloatArray = origin + grid.resolution * (between - grid.half - 0.5)
    return LiveForecast(
        probability.cpu().numpy(),
        corner,
        time + delay + interval * steps.astype(np.float64),
        grid.resolution,
        time,
        delay,
        None if samples is None else samples.cpu().numpy(),
    )


def _steps(delay: float, interval: float) -> float:
    """A delay in intervals between frames: whole ones where it is as near to that as stamps tell."""
    steps = delay / interval
    return float(round(steps)) if abs(steps - round(steps)) < NEAR else steps


def _between(
    grids: Tensor, centres: NDArray[np.int64], lower: int, upper: int, share: float, centre: NDArray[np.int64]
) -> Tensor:
    """The grid (..., H, W) at a moment between two horizons of `grids` (..., N + 1, H, W)."""
    first, second = (
        shifted_tensor(grids[..., k, :, :], (centre - centres[k]).tolist(), float("nan")) for k in (lower, upper)
    )
    mixed = (1 - share) * first + share * second
    mixed = torch.where(mixed.isnan(), torch.where(first.isnan(), second, first), mixed)
    return mixed.nan_to_num(nan=UNKNOWN)
