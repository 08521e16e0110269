"""How likely a given path meets something, by time: the ego's body along it, over a forecast of where something is."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from envpred.errors import UserError
from envpred.live.placed import Grids, PlacedForecast
from envpred.mapping.ego_motion import cells_of, in_cells
from envpred.mapping.geometry import Body, FloatArray

# A sample draws the noise of single measurements, too: one hit in a cell that was free makes about 0.7 of it, for a
# frame.  With one cell of 0.5 nearly every path meets something; two of 0.8 fit what two real drives have come to.
OCCUPIED, CELLS = 0.8, 2


class Risk(NamedTuple):
    """What a path risks up to each of the M horizons that it reaches.

    With samples the probability is the share of them in which something was under the body so far, and `least`,
    `independent` and `most` are the same.  Without, a forecast says of each cell alone how likely it is occupied, and
    not how cells hang together, so that there are bounds: the event is as likely as the likeliest cell at `least`, if
    all others are occupied only when that one is, and as likely as the sum over cells and horizons at `most` (Boole),
    if no two ever are; `independent` is 1 - prod(1 - p), if none knew of another.  A car that stands there or does not,
    which covers many cells, is near `least`.

    Args:
        time: (M,) seconds from the last frame shown.
        least: (M,) lower bound of the probability to have met something by then.
        independent: (M,) the probability if cells and horizons were independent.
        most: (M,) upper bound.
        unknown: (M,) share of the cells under the body at that time of which nothing is known, outside of the grid or
            never seen: they count as free, and whoever asks must say what they are worth.
        samples: how many the probability is from, 0 where there are bounds alone.
    """

    time: FloatArray
    least: FloatArray
    independent: FloatArray
    most: FloatArray
    unknown: FloatArray
    samples: int


def risk(
    plan: FloatArray,
    forecast: PlacedForecast,
    body: Body | None = None,
    margin: float = 0.0,
    occupied: float = OCCUPIED,
    cells: int = CELLS,
) -> Risk:
    """The probability that the ego's body meets something on a path, by time.

    Args:
        plan: (P, 4) rows of x, y (metres in the world) and heading (radians, counter-clockwise from east) of the body
            frame, and time (seconds from the last frame shown); between rows it goes straight on.  It is looked at
            when the forecast's horizons are, up to its own end.
        forecast: of what may be met.
        body: of the ego in the sensor frame; by default the forecast's.
        margin: metres that the body is made larger by on all sides.
        occupied: a sample says of a cell that it is occupied by more than this.
        cells: so many of them under the body at once make something in a sample, and no noise.

    Raises:
        UserError: if the plan holds no poses, its times do not increase, it begins after the first horizon or ends
            before it.
    """
    poses = poses_at(np.asarray(plan, np.float64), forecast)
    rear, front, half_width = forecast.body if body is None else (body.rear, body.front, body.half_width)
    box = rear - margin, front + margin, half_width + margin
    under = [cells_under(pose, forecast.sensor, box, forecast.resolution) for pose in poses]
    times = forecast.horizon_s[: len(poses)]

    drawn = [_values(grids, ego, under) for grids, ego in forecast.sampled()]
    if drawn:
        met = np.array([[np.count_nonzero(values > occupied) >= cells for values in sample] for sample in drawn])
        share = np.logical_or.accumulate(met, axis=1).mean(axis=0)
        unknown = np.array([[np.isnan(values).mean() for values in sample] for sample in drawn]).mean(axis=0)
        return Risk(times, share, share, share, unknown, len(drawn))

    told = _values(forecast.told(), forecast.ego, under)
    known = [values[np.isfinite(values)].astype(np.float64) for values in told]
    least = np.maximum.accumulate([values.max(initial=0) for values in known])
    most = np.minimum(np.cumsum([values.sum() for values in known]), 1)
    spared = np.cumprod([np.prod(1 - values) for values in known])
    return Risk(times, least, 1 - spared, most, np.array([np.isnan(values).mean() for values in told]), 0)


def poses_at(plan: FloatArray, forecast: PlacedForecast) -> FloatArray:
    """Poses (M, 3), in cells and radians, at the horizons that the plan reaches."""
    if plan.ndim != 2 or plan.shape[1] != 4 or not len(plan) or not np.isfinite(plan).all():
        raise UserError(f"a plan holds rows of x, y, heading and time, all finite: (N, 4), not {plan.shape}")
    time, horizons = plan[:, 3], forecast.horizon_s
    if (np.diff(time) <= 0).any():
        row = int(np.flatnonzero(np.diff(time) <= 0)[0]) + 1
        raise UserError(f"row {row} of the plan is at {time[row]:g} s, no later than the one before; sort it by time")
    near = 1e-6 * forecast.period  # a row at a horizon is at it, whatever rounding says
    if time[0] > horizons[0] + near or time[-1] < horizons[0] - near:
        raise UserError(
            f"the plan lasts from {time[0]:g} to {time[-1]:g} s after the last frame shown and misses the first "
            f"horizon, {horizons[0]:g} s; begin it at the present, and end it later"
        )
    at = horizons[horizons <= time[-1] + near]
    columns = plan[:, 0], plan[:, 1], np.unwrap(plan[:, 2])
    poses = np.stack([np.interp(at, time, column) for column in columns], axis=1)
    return in_cells(poses, np.array(forecast.origin), forecast.resolution)


def cells_under(
    pose: FloatArray, sensor: tuple[float, float, float], body: tuple[float, float, float], resolution: float
) -> NDArray[np.int64]:
    """Lattice cells (n, 2) that the body at `pose` (3,) overlaps, by separating axes; a shared border is no overlap."""
    rear, front, half_width = (value / resolution for value in body)
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    place = pose[:2] + np.array([sensor[0] * cos - sensor[1] * sin, sensor[0] * sin + sensor[1] * cos]) / resolution
    cos, sin = np.cos(pose[2] + sensor[2]), np.sin(pose[2] + sensor[2])
    middle = place + (rear + front) / 2 * np.array([cos, sin])
    half = (front - rear) / 2
    reach = int(np.ceil(np.hypot(half, half_width))) + 1
    first = np.floor(middle + 0.5).astype(np.int64) - reach
    cells: NDArray[np.int64] = first + np.argwhere(np.ones((2 * reach + 1, 2 * reach + 1), np.bool_))
    east, north = (cells - middle).T
    wide, high = half * abs(cos) + half_width * abs(sin), half * abs(sin) + half_width * abs(cos)
    corner = (abs(cos) + abs(sin)) / 2  # how far a cell reaches along either axis of the body
    near = 1e-9
    overlaps = (np.abs(east) < wide + 0.5 - near) & (np.abs(north) < high + 0.5 - near)
    overlaps &= np.abs(cos * east + sin * north) < half + corner - near
    overlaps &= np.abs(cos * north - sin * east) < half_width + corner - near
    found: NDArray[np.int64] = cells[overlaps]
    return found


def _values(told: Grids, ego: FloatArray, under: list[NDArray[np.int64]]) -> list[Grids]:
    """What `told` (N, H, W), in the grids of an `ego` (N, 3), says of the cells of each horizon."""
    found = []
    for grid, centre, cells in zip(told, cells_of(ego), under, strict=False):
        i, j = (cells - centre + grid.shape[-1] // 2).T
        inside = (i >= 0) & (i < grid.shape[0]) & (j >= 0) & (j < grid.shape[1])
        values = np.full(len(cells), np.nan, np.float32)
        values[inside] = grid[i[inside], j[inside]]
        found.append(values)
    return found
