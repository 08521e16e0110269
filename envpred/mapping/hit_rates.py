"""How often a scan will hit a cell: a calibrated model of hits that come and go, from the labels and masses shown.

A wall that was hit in four of five frames is hit again in most; a far one is hit rarely, because beams are sparse
there, and more often as the ego comes nearer; what is seen from a place that the ego does not leave is seen again.
A logistic model of few local features says so; its weights make later labels likeliest (`hit_rate_fit`).
"""

import json
from dataclasses import dataclass
from functools import cache
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from envpred.compiled import njit
from envpred.mapping.evidence import Mass
from envpred.mapping.geometry import FREE, OCCUPIED, FloatArray
from envpred.mapping.world import Grids, World, check_context

SHOWN = 5  # frames that the model looks back on
FEATURES = 22
# Six scores a cell: alone; times the logarithm of the horizon; times the root of the distance that the ego has moved;
# where it has not; times the range then; times the change of the range.
SCORES = 6
# The features whose effect depends on the range: hits in all frames, m(O), m(F), their log-ratio, hits around.
RANGED = 6
NUMBERS = 4 * FEATURES + 5 + 2 * RANGED
LARGEST = np.float32(0.995)
_RANGE = 20.0  # metres; ranges are counted in these
NEAR = 1.1  # metres: from further away nothing counts of what was seen from there, see `World.near`
_STOOD = 0.2  # metres: who has moved less has stood


@dataclass(frozen=True)
class HitRates:
    """Weights of the two logistic models.

    Args:
        hit: (105,) of the probability that a cell is hit: 4 x 22 of the features (alone, by log-horizon, by distance
            moved, where the ego stands), 5 of the ranges, 2 x 6 of features by range.
        seen: (105,) alike, of the probability that a cell that is not hit is seen to be free.
    """

    hit: FloatArray
    seen: FloatArray

    def __post_init__(self) -> None:
        for weights in (self.hit, self.seen):
            if np.shape(weights) != (NUMBERS,):
                raise ValueError(f"{NUMBERS} weights expected, not {np.shape(weights)}")

    def world(
        self,
        labels: NDArray[np.uint8],
        centre_cells: NDArray[np.integer],
        mass: Mass,
        futures: FloatArray,
        pose: FloatArray,
        resolution: float,
        cells: int,
        period: float = 0.1,
    ) -> World:
        """The world that scans from the `futures` meet.

        Args:
            labels: (T, W, W) label codes of the frames shown in the context grid, the last frame last.
            centre_cells: (T, 2) lattice cells at their centres.
            mass: (2, W, W) masses of the last frame in the context grid.
            futures: (K, N, 3) poses of the ego in cells and radians; the world is that of their mean, and only what
                the judged grids of all of them cover is filled in.
            pose: (2 or 3,) the ego's last pose, cells.
            resolution: a cell's side, metres.
            cells: of the judged grid's side.
            period: seconds between frames.
        """
        W, N = labels.shape[-1], futures.shape[1]
        check_context(W, cells)
        # One cell more than needed, for worlds turned round.
        base = np.asarray(centre_cells[-1], np.int64) - W // 2
        corners = np.floor(futures[..., :2] + 0.5).astype(np.int64) - cells // 2 - base
        low, high = np.clip(corners.min(axis=0), 0, W), np.clip(corners.max(axis=0) + cells + 1, 0, W)  # (N, 2)
        part = (*low.min(axis=0).tolist(), *high.max(axis=0).tolist())
        found = features(labels, centre_cells, mass, part)
        mean = futures.mean(axis=0)
        ahead = conditions(mean, pose, resolution, period)
        near = (np.linalg.norm(futures[..., :2] - pose[:2], axis=2).min(axis=0) * resolution < NEAR).tolist()
        here, then = np.asarray(pose[:2]) - base, mean[:, :2] - base
        step, boxes = resolution / _RANGE, np.concatenate([low, high], axis=1) - [*part[:2], *part[:2]]
        corner = np.array(part[:2])
        grids: list[Grids] = []
        for weights in (self.hit, self.seen)[: 1 + any(near)]:
            scores, ranges = _scores(found, weights), np.asarray(weights[4 * FEATURES :][:5], np.float32)
            grid = np.zeros((N, *scores.shape[1:]), np.float32)
            for h, (west, south, east, north) in enumerate(boxes.tolist()):
                if grids and not near[h]:
                    continue
                box, first = np.empty((east - west, north - south), np.float32), np.array([west, south])
                place = corner + first
                _logits(box, scores, first, place - here, place - then[h], ahead[h], ranges, step)
                grid[h, west:east, south:north] = _sigmoid(box)
            grids.append(grid)
        place = float(pose[0]), float(pose[1])
        return World(grids[0], grids[1] if any(near) else None, place, part=part, context=W)


@cache
def default() -> HitRates:
    """The weights that come with the package."""
    table = json.loads((resources.files("envpred.mapping") / "hit_rates.json").read_text("utf-8"))
    return HitRates(np.array(table["hit"]), np.array(table["seen"]))


def conditions(futures: FloatArray, pose: FloatArray, resolution: float, period: float) -> Grids:
    """What a horizon has of its own (N, 3): log of time in 0.1 s, root of distance in 10 m, whether the ego stood."""
    moved = np.linalg.norm(futures[:, :2] - np.asarray(pose[:2]), axis=1) * resolution
    time = np.log(np.arange(1, len(futures) + 1) * period / 0.1)
    root = np.sqrt(np.minimum(np.where(moved < 0.05, 0, moved), 30) / 10)
    return np.stack([time, root, moved < _STOOD], axis=1).astype(np.float32)


def features(
    labels: NDArray[np.uint8],
    centre_cells: NDArray[np.integer],
    mass: Mass,
    part: tuple[int, int, int, int],
) -> Grids:
    """The features (22, I, J) of the cells in `part` (first and end along either axis) of the last context grid.

    Args: as `HitRates.world`.
    """
    W = labels.shape[-1]
    west, south, east, north = part
    pad = 2  # what is around a cell reaches so far
    region = (max(west - pad, 0), max(south - pad, 0), min(east + pad, W), min(north + pad, W))
    size = region[2] - region[0], region[3] - region[1]
    hit, free = np.zeros((SHOWN, *size), np.float32), np.zeros((SHOWN, *size), np.float32)
    for k in range(min(SHOWN, len(labels))):
        shift = np.asarray(centre_cells[-1], np.int64) - np.asarray(centre_cells[-1 - k], np.int64)
        seen = _shifted(labels[-1 - k], region, shift)
        hit[k], free[k] = seen == OCCUPIED, seen == FREE
    occupied, empty = (m[region[0] : region[2], region[1] : region[3]] for m in mass.astype(np.float32))
    sums = hit.sum(axis=0)
    around, before = _around(hit[0]) - hit[0], _around(sums - hit[0]) - (sums - hit[0])
    grids = [
        np.ones(size, np.float32),
        *hit,
        *free,
        occupied,
        empty,
        np.log((occupied + 0.02) / (empty + 0.02)),
        np.log(np.maximum(1 - occupied - empty, 0) + 0.01),
        around / 8,
        before / 32,
        (_around(free.sum(axis=0)) - free.sum(axis=0)) / 40,
        _around(_around(sums)) / 405,
        sums > 0,
        occupied > 0.9,
        _around(occupied) / 9,
    ]
    inner = (slice(west - region[0], east - region[0]), slice(south - region[1], north - region[1]))
    return np.stack([np.asarray(grid[inner], np.float32) for grid in grids])


def ranged(found: Grids) -> Grids:
    """Those of the features (22, ...) whose effect depends on the range (6, ...)."""
    return np.stack([found[1:6].mean(axis=0), found[11], found[12], found[13], found[15], found[18]])


def _scores(found: Grids, weights: FloatArray) -> Grids:
    """The six scores (6, I, J) of the cells."""
    by_condition = np.asarray(weights[: 4 * FEATURES], np.float32).reshape(4, FEATURES)
    by_range = np.asarray(weights[4 * FEATURES + 5 :], np.float32).reshape(2, RANGED)
    scores = np.zeros((SCORES, *found.shape[1:]), np.float32)
    flat = scores.reshape(SCORES, -1)
    _weigh(flat[:4], by_condition, found.reshape(FEATURES, -1))
    _weigh(flat[4:], by_range, ranged(found).reshape(RANGED, -1))
    return scores


@njit(nogil=True, fastmath=True)
def _weigh(out, weights, values):  # type: ignore[no-untyped-def]
    """`out` += `weights` @ `values`.  BLAS does it on threads of its own, which spin beside those that cast rays."""
    block = 2048  # cells whose values stay in the cache
    for start in range(0, out.shape[1], block):
        end = min(start + block, out.shape[1])
        for s in range(len(out)):
            line = out[s, start:end]
            for f in range(len(values)):
                weight, row = weights[s, f], values[f, start:end]
                for n in range(len(line)):
                    line[n] += weight * row[n]


def _shifted(grid: NDArray[np.uint8], region: tuple[int, int, int, int], shift: NDArray[np.int64]) -> NDArray[np.uint8]:
    """The `region` of a grid as seen from one whose cells lie `shift` further; 0 where it does not reach."""
    W = grid.shape[-1]
    out = np.zeros((region[2] - region[0], region[3] - region[1]), np.uint8)
    first, end = np.array(region[:2]) + shift, np.array(region[2:]) + shift
    (a, b), (c, d) = np.clip(first, 0, W).tolist(), np.clip(end, 0, W).tolist()
    if c > a and d > b:
        i, j = a - int(first[0]), b - int(first[1])
        out[i : i + c - a, j : j + d - b] = grid[a:c, b:d]
    return out


def _around(grid: Grids) -> Grids:
    """Sum over 3 x 3 cells."""
    padded = np.pad(grid, 1)
    rows = padded[:-2] + padded[1:-1] + padded[2:]
    total: Grids = rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:]
    return total


def _sigmoid(logits: Grids) -> Grids:
    """Probabilities of `logits`, in place.  NumPy's exponential takes many cells at once, a compiled loop's one."""
    np.negative(logits, out=logits)
    np.minimum(logits, np.float32(80), out=logits)  # no overflow
    np.exp(logits, out=logits)
    logits += np.float32(1)
    np.reciprocal(logits, out=logits)
    return np.minimum(logits, LARGEST, out=logits)


@njit(nogil=True, fastmath=True)
def _logits(out, scores, first, here, then, ahead, ranges, step):  # type: ignore[no-untyped-def]
    """Logits of one horizon in a box: its first cell is `first` of the scores', and `here` and `then` off the ego."""
    time, root, stood = ahead
    # Locals, because the compiler cannot know that writing to `out` leaves these arrays alone.
    by_now, by_later, by_now_2, by_later_2, by_both = ranges
    here_j, then_j = np.float32(here[1]), np.float32(then[1])
    step = np.float32(step)
    for i in range(out.shape[0]):
        row = scores[:, first[0] + i, first[1] : first[1] + out.shape[1]]
        now_i, later_i = np.float32((here[0] + i) ** 2), np.float32((then[0] + i) ** 2)
        line = out[i]
        for j in range(len(line)):
            at = np.float32(j)
            now = np.sqrt(now_i + (here_j + at) ** 2) * step
            later = np.sqrt(later_i + (then_j + at) ** 2) * step
            line[j] = (
                row[0, j]
                + time * row[1, j]
                + root * row[2, j]
                + stood * row[3, j]
                + later * row[4, j]
                + (now - later) * row[5, j]
                + by_now * now
                + by_later * later
                + by_now_2 * now * now
                + by_later_2 * later * later
                + by_both * now * later
            )
