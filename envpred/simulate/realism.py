"""How real simulated drives look: what the method makes of them, beside the same figures of real drives."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from envpred.build.grids import mapped, mapper_of
from envpred.drives import Drive, find_drives
from envpred.mapping.evidence import pignistic
from envpred.mapping.geometry import FREE, OCCUPIED
from envpred.mapping.mapper import MappingParameters
from envpred.mapping.shift import overlap

_WINDOW, _GIVEN = 20, 5  # frames of a window, and how many of them the static baseline may see
_HORIZONS = (1, 5, 10, 15)  # frames ahead
_MOVED = 5  # frames after which an occupied cell that has become free counts as moved


@dataclass(frozen=True)
class Figures:
    """What one drive looks like to the method.

    Attributes:
        points: median number of points a scan.
        obstacles: median number of points left after ground removal.
        shares: of the label grid's cells: unknown, occupied, free, ego.
        static: mean squared error x 1e-3 of the static baseline after 0.1, 0.5, 1.0, 1.5 s; NaN without a whole window.
        moved: share of the occupied cells that are free 0.5 s later (the grid's own motion taken out).
        speed: mean speed of the ego, m/s.
    """

    points: float
    obstacles: float
    shares: tuple[float, ...]
    static: tuple[float, ...]
    moved: float
    speed: float


def figures(drive: Drive) -> Figures:
    """The figures of one drive, mapped with the paper's parameters."""
    frames = []
    obstacles, points = [], []
    for frame in mapped(drive, mapper_of(drive, MappingParameters())):
        points.append(len(frame.obstacle))
        obstacles.append(int(frame.obstacle.sum()))
        frames.append(frame[:3])
    labels, masses, centre = (np.stack(values) for values in zip(*frames, strict=True))
    probability = pignistic(masses)
    windows = [probability[a : a + _WINDOW] for a in range(0, len(labels) - _WINDOW + 1, _WINDOW)]
    errors = [[((w[_GIVEN - 1] - w[_GIVEN - 1 + h]) ** 2).mean() for h in _HORIZONS] for w in windows]
    steps = np.hypot(*np.diff(drive.poses[:, :2, 3], axis=0).T)
    seconds = drive.times[-1] - drive.times[0]
    return Figures(
        float(np.median(points)),
        float(np.median(obstacles)),
        tuple(float((labels == code).mean()) for code in range(4)),
        tuple(1e3 * np.mean(errors, axis=0)) if errors else (float("nan"),) * len(_HORIZONS),
        _moved(labels, centre),
        float(steps.sum() / max(seconds, 1e-9)),
    )


def _moved(labels: np.ndarray, centre: np.ndarray) -> float:
    """Share of occupied cells that are seen free `_MOVED` frames later at the same place of the world."""
    gone, all_ = 0, 0
    for t in range(0, len(labels) - _MOVED, _MOVED):
        there, here = overlap(centre[t + _MOVED] - centre[t], labels.shape[1:])
        now, then = labels[t][here], labels[t + _MOVED][there]
        gone += int(((now == OCCUPIED) & (then == FREE)).sum())
        all_ += int(((now == OCCUPIED) & ((then == FREE) | (then == OCCUPIED))).sum())
    return gone / max(all_, 1)


_ROWS: tuple[tuple[str, Callable[[Figures], float], str], ...] = (
    ("points a scan", lambda f: f.points, "{:9.0f}"),
    ("left after ground removal", lambda f: f.obstacles, "{:9.0f}"),
    ("share unknown", lambda f: f.shares[0], "{:9.3f}"),
    ("share occupied", lambda f: f.shares[1], "{:9.3f}"),
    ("share free", lambda f: f.shares[2], "{:9.3f}"),
    ("share ego", lambda f: f.shares[3], "{:9.4f}"),
    ("static, MSE x 1e-3, 0.1 s", lambda f: f.static[0], "{:9.1f}"),
    ("static, MSE x 1e-3, 0.5 s", lambda f: f.static[1], "{:9.1f}"),
    ("static, MSE x 1e-3, 1.0 s", lambda f: f.static[2], "{:9.1f}"),
    ("static, MSE x 1e-3, 1.5 s", lambda f: f.static[3], "{:9.1f}"),
    ("occupied, free 0.5 s later", lambda f: f.moved, "{:9.3f}"),
    ("ego speed, m/s", lambda f: f.speed, "{:9.2f}"),
)


def realism(simulated: Path, real: Path) -> str:
    """A table of the figures of simulated drives (mean, least, largest) beside those of real ones, drive by drive.

    Raises:
        UserError: if one of the folders holds no drive.
    """
    ours, theirs = ([figures(drive) for drive in find_drives(root)] for root in (simulated, real))
    head = f"{'':28}{'simulated':>9} {'least':>9} {'largest':>9}  |{'real':>10}" + " " * 10 * (len(theirs) - 1)
    lines = [head.rstrip()]
    for name, value, form in _ROWS:
        mine = np.array([value(f) for f in ours])
        known = mine[np.isfinite(mine)]
        cells = [form.format(v(known)) if len(known) else " " * 9 for v in (np.mean, np.min, np.max)]
        others = " ".join(form.format(value(f)) for f in theirs)
        lines.append(f"{name:28}{' '.join(cells)}  | {others}")
    return "\n".join(lines)
