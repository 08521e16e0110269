"""How real simulated drives look: what the method makes of them, as distributions over drives beside real ones."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import wasserstein_distance

from envpred.build.grids import mapped, mapper_of
from envpred.drives import Drive, find_drives
from envpred.mapping.evidence import pignistic
from envpred.mapping.geometry import FREE, OCCUPIED
from envpred.mapping.mapper import MappingParameters
from envpred.mapping.shift import overlap
from envpred.simulate.mesh import FloatArray

Figures = dict[str, float]

_WINDOW, _GIVEN = 20, 5  # frames of a window, and how many of them the static baseline may see
_HORIZONS = (1, 5, 10, 15)  # frames ahead
_LATER = 5  # frames after which a cell is looked at again; every so many scans are looked at closely
_STANDS = 0.3  # m/s
_TURNS = 0.1  # rad/s
_SPEEDS_UP = 0.5  # m/s^2, over a second
LOW, HIGH = 5, 95  # percentiles of the simulated drives, between which a real one should lie


def figures(drive: Drive) -> Figures:
    """What one drive looks like to the method with the paper's parameters; NaN where it is too short to tell."""
    frames = list(mapped(drive, mapper_of(drive, MappingParameters())))
    labels, masses, centre = (np.stack([getattr(f, n) for f in frames]) for n in ("label", "mass", "centre_cell"))
    shares = [float((labels == code).mean()) for code in range(4)]
    return {
        "points a scan": float(np.median([len(frame.obstacle) for frame in frames])),
        "left after ground removal": float(np.median([frame.obstacle.sum() for frame in frames])),
        **_returns(drive),
        **dict(zip(("share unknown", "share occupied", "share free", "share ego"), shares, strict=True)),
        **_static(pignistic(masses)),
        **changes(labels, centre),
        **_motion(drive),
    }


def _returns(drive: Drive) -> Figures:
    """Where returns come from: by range, by height above the road, and by elevation, which tells the beams."""
    points = np.concatenate([drive.scan(k)[:, :3] for k in drive.frames[::_LATER]]).astype(np.float64)
    reach = np.hypot(points[:, 0], points[:, 1])
    height = points[:, 2] + drive.sensor_height
    elevation = np.degrees(np.arctan2(points[:, 2], np.maximum(reach, 1e-6)))
    far, high = (np.cumsum(_shares(values, edges)) for values, edges in ((reach, (10, 20, 40)), (height, (0.3, 2))))
    return {
        "returns within 10 m": far[0],
        "returns within 20 m": far[1],
        "returns within 40 m": far[2],
        "returns below 0.3 m": high[0],
        "returns below 2 m": high[1],
        **{f"elevation of returns, {q} %": float(np.percentile(elevation, q)) for q in (LOW, 50, HIGH)},
    }


def _shares(values: FloatArray, edges: Sequence[float]) -> FloatArray:
    counts = np.bincount(np.digitize(values, edges), minlength=len(edges) + 1)
    return np.asarray(counts / max(len(values), 1))


def _static(probability: NDArray[np.float32]) -> Figures:
    """Mean squared error x 1e-3 of the static baseline, window after window."""
    windows = [probability[a : a + _WINDOW] for a in range(0, len(probability) - _WINDOW + 1, _WINDOW)]
    errors = [[1e3 * ((w[_GIVEN - 1] - w[_GIVEN - 1 + h]) ** 2).mean() for h in _HORIZONS] for w in windows]
    means = np.mean(errors, axis=0) if errors else np.full(len(_HORIZONS), np.nan)
    return {f"static, MSE x 1e-3, {h / 10:.1f} s": float(mean) for h, mean in zip(_HORIZONS, means, strict=True)}


def changes(labels: NDArray[np.uint8], centre: NDArray[np.int32]) -> Figures:
    """What becomes of cells at their place in the world 0.5 s later, and how many enter within 1.5 s."""
    counts = np.zeros((2, 2))
    kept = np.zeros(2)
    for t in range(0, len(labels) - _LATER, _LATER):
        step = centre[t + _LATER] - centre[t]
        there, here = overlap(step, labels.shape[1:])
        now, then = labels[t][here], labels[t + _LATER][there]
        known = ((now == OCCUPIED) | (now == FREE)) & ((then == OCCUPIED) | (then == FREE))
        was, became = now[known] == OCCUPIED, then[known] == OCCUPIED
        counts += [[(was & became).sum(), (was & ~became).sum()], [(~was & became).sum(), (~was & ~became).sum()]]
        if step.any():
            seen = (now == OCCUPIED) | (now == FREE)
            kept += [(now[seen] == then[seen]).sum(), seen.sum()]
    horizon = _HORIZONS[-1]
    n = labels.shape[-1]
    stay = [np.prod(np.maximum(n - np.abs(b - a), 0)) / n**2 for a, b in zip(centre, centre[horizon:], strict=False)]
    return {
        "occupied, free 0.5 s later": _ratio(counts[0, 1], counts[0].sum()),
        "free, occupied 0.5 s later": _ratio(counts[1, 0], counts[1].sum()),
        "label kept for 0.5 s, ego moving": _ratio(*kept),
        "cells that enter within 1.5 s": 1 - float(np.mean(stay)) if stay else float("nan"),
    }


def _ratio(part: float, whole: float) -> float:
    return float(part / whole) if whole else float("nan")


def _motion(drive: Drive) -> Figures:
    """How the ego moves."""
    poses, steps = drive.poses, np.diff(drive.times)
    speed = np.hypot(*np.diff(poses[:, :2, 3], axis=0).T) / steps
    heading = np.unwrap(np.arctan2(poses[:, 1, 0], poses[:, 0, 0]))
    second = max(round(1 / drive.period), 1)
    change = (speed[second:] - speed[:-second]) / (second * drive.period)
    return {
        **{f"ego speed, {q} %, m/s": float(np.percentile(speed, q)) for q in (LOW, 50, HIGH)},
        "share of time standing": float((speed < _STANDS).mean()),
        "share of time turning": float((np.abs(np.diff(heading) / steps) > _TURNS).mean()),
        "share of time changing speed": float((np.abs(change) > _SPEEDS_UP).mean()) if len(change) else float("nan"),
    }


def realism(simulated: Path, real: Path) -> str:
    """A table of the figures of simulated drives (percentiles over drives) beside those of real ones, drive by drive.

    A star marks a real drive that lies outside the simulated 5 to 95 % range.  The distance is the earth mover's,
    between the real and the simulated drives, in standard deviations of the simulated ones.

    Raises:
        UserError: if one of the folders holds no drive.
    """
    ours, theirs = ({drive.name: figures(drive) for drive in find_drives(root)} for root in (simulated, real))
    names = [name.removesuffix("_sync").rsplit("_", 1)[-1][:9] for name in theirs]
    head = " ".join(f"{f'{q} %':>9}" for q in (LOW, 50, HIGH))
    drives = f"{len(ours)} simulated, {len(theirs)} real drives"
    lines = [f"{drives:34}{head} |{''.join(f'{name:>10} ' for name in names)}| distance"]
    outside: dict[str, list[str]] = {name: [] for name in theirs}
    for row in next(iter(ours.values())):
        mine, real_ones = (np.array([found[row] for found in side.values()]) for side in (ours, theirs))
        known = mine[np.isfinite(mine)]
        low, middle, high = np.percentile(known, (LOW, 50, HIGH)) if len(known) else [np.nan] * 3
        cells = []
        for name, value in zip(theirs, real_ones, strict=True):
            beyond = bool(value < low or value > high)
            outside[name] += [row] * beyond
            cells.append(f"{_number(value):>10}{'*' if beyond else ' '}")
        left = " ".join(f"{_number(value):>9}" for value in (low, middle, high))
        lines.append(f"{row:34}{left} |{''.join(cells)}| {_number(_distance(real_ones, known)):>8}")
    lines += [
        f"{name}: outside in {len(rows)} of {len(next(iter(ours.values())))}: {'; '.join(rows) or 'none'}"
        for name, rows in outside.items()
    ]
    return "\n".join(lines)


def _distance(real: FloatArray, simulated: FloatArray) -> float:
    known = real[np.isfinite(real)]
    spread = simulated.std() if len(simulated) else 0.0
    if not len(known) or spread <= 1e-6 * np.abs(simulated).max(initial=0):  # one drive, or all alike
        return float("nan")
    return float(wasserstein_distance(known, simulated) / spread)


def _number(value: float) -> str:
    if not np.isfinite(value):
        return "-"
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.3f}" if abs(value) < 10 else f"{value:.1f}"
