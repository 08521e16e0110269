"""Ground segmentation: the Markov random field of Postica, Romanoni and Matteucci (2016), and a RANSAC plane beside it.

In the random field the height of the ground spreads from the vehicle outwards, ring by ring: a cell is ground if its
points span little height and do not rise far above the ground next to it one ring further in.  As every cell depends
only on the ring inside its own, one pass is exact and nothing is iterated.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from envpred.compiled import njit
from envpred.errors import check_number
from envpred.mapping.geometry import PAPER_SENSOR_HEIGHT


class GroundSegmenter(ABC):
    """Anything that tells obstacle points from ground."""

    @abstractmethod
    def obstacles(
        self,
        points: NDArray[np.float32],
        reach: float,
        sensor_height: float = PAPER_SENSOR_HEIGHT,
        context_reach: float | None = None,
    ) -> NDArray[np.bool_]:
        """Which points are obstacles: (N,) bool.

        Args:
            points: (N, >=3) in the sensor frame, metres.
            reach: points with |x| or |y| beyond it (metres) take no part, see `GridSpec.reach`.
            sensor_height: height of the sensor above the road in metres.
            context_reach: that of a wider grid: points between the two take part too, but have no say about those
                within `reach`, whose verdicts are to the bit what they are without them.
        """


@dataclass(frozen=True)
class MarkovRandomField(GroundSegmenter):
    """Ground segmentation of Postica et al. 2016 with the parameters of Itkina et al. 2019.

    Args:
        cell: side of a cell in metres.
        ceiling: points above it in the sensor frame (metres) take no part.
        max_span: largest height that the points of a ground cell may span, in metres.
        max_rise: largest rise of a ground cell above its neighbours one ring further in, in metres.
    """

    cell: float = 0.4
    ceiling: float = 3.5
    max_span: float = 0.3
    max_rise: float = 0.3

    def __post_init__(self) -> None:
        check_number("ground.cell", self.cell, above=True)
        for name in ("max_span", "max_rise"):
            check_number(f"ground.{name}", getattr(self, name))

    def obstacles(
        self,
        points: NDArray[np.float32],
        reach: float,
        sensor_height: float = PAPER_SENSOR_HEIGHT,
        context_reach: float | None = None,
    ) -> NDArray[np.bool_]:
        """Which points are obstacles: (N,) bool; the ground of an empty centre cell lies at -`sensor_height`.

        The field of a wider grid is that of the judged one with more rings around it, so one pass serves both.
        """
        far = reach if context_reach is None else max(reach, context_reach)
        last = int(np.rint(np.float32(reach) / self.cell))
        half = max(int(np.ceil(far / self.cell)), last + 1)
        limits = np.float32(reach), np.float32(far), np.float32(self.ceiling)
        cells, highest, lowest = _heights(points, self.cell, half, last, *limits)
        obstacle_cell = _spread(highest, lowest, half, self.max_span, self.max_rise, -sensor_height)
        obstacle: NDArray[np.bool_] = _gather(obstacle_cell.ravel(), cells)
        return obstacle


@dataclass(frozen=True)
class RansacPlane(GroundSegmenter):
    """One plane through the whole scan by random sample consensus (Fischler and Bolles 1981), for comparison.

    Args:
        distance: points within it of the plane (metres) are ground.
        trials: planes tried, each through three random points.
        max_tilt: steepest plane in degrees that is taken for ground; keeps facades out.
        ceiling: as for the random field.
        seed: of the samples; the same for every scan, so that a scan's result depends on nothing else.
    """

    distance: float = 0.2
    trials: int = 100
    max_tilt: float = 15.0
    ceiling: float = 3.5
    seed: int = 0

    def __post_init__(self) -> None:
        check_number("ground.distance", self.distance, above=True)
        check_number("ground.trials", self.trials, 1)
        check_number("ground.max_tilt", self.max_tilt, 0, 90)
        check_number("ground.seed", self.seed)

    def obstacles(
        self,
        points: NDArray[np.float32],
        reach: float,
        sensor_height: float = PAPER_SENSOR_HEIGHT,
        context_reach: float | None = None,
    ) -> NDArray[np.bool_]:
        """Which points are obstacles: (N,) bool; the plane is that of the points within `reach`."""
        taken = self._taking_part(points, reach)
        inside = np.ascontiguousarray(points[taken, :3])
        if len(inside) < 3:
            return np.zeros(len(points), np.bool_)
        samples = inside[np.random.default_rng(self.seed).integers(len(inside), size=(self.trials, 3))].astype(float)
        normals = np.cross(samples[:, 1] - samples[:, 0], samples[:, 2] - samples[:, 0])
        lengths = np.linalg.norm(normals, axis=1)
        level = np.abs(normals[:, 2]) >= np.cos(np.radians(self.max_tilt)) * lengths
        usable = level & (lengths > 0)
        if not usable.any():
            return taken if context_reach is None else self._taking_part(points, max(reach, context_reach))
        normals = (normals[usable] / lengths[usable, None]).astype(np.float32)
        offsets = -(normals * samples[usable, 0]).sum(axis=1).astype(np.float32)
        best = int(np.argmax(_count_inliers(inside, normals, offsets, np.float32(self.distance))))
        obstacle = taken.copy()
        obstacle[taken] = np.abs(inside @ normals[best] + offsets[best]) > self.distance
        if context_reach is not None:  # apart from the others, as a product's rounding may depend on its size
            beyond = self._taking_part(points, context_reach) & ~taken
            outside = np.ascontiguousarray(points[beyond, :3])
            obstacle[beyond] = np.abs(outside @ normals[best] + offsets[best]) > self.distance
        return obstacle

    def _taking_part(self, points: NDArray[np.float32], reach: float) -> NDArray[np.bool_]:
        near: NDArray[np.bool_] = (np.abs(points[:, :2]) <= reach).all(axis=1) & (points[:, 2] <= self.ceiling)
        return near


@njit(nogil=True)
def _count_inliers(points, normals, offsets, distance):  # type: ignore[no-untyped-def]
    """Points within `distance` of each plane."""
    counts = np.zeros(len(normals), np.int64)
    for k in range(len(normals)):
        for n in range(len(points)):
            height = points[n, 0] * normals[k, 0] + points[n, 1] * normals[k, 1] + points[n, 2] * normals[k, 2]
            counts[k] += abs(height + offsets[k]) <= distance
    return counts


@njit(nogil=True)
def _heights(points, side, half, last, reach, far, ceiling):  # type: ignore[no-untyped-def]
    """Flat cell of each point (-1: takes no part), and the highest and lowest z of every cell.

    Points beyond `reach` count for the rings beyond `last`, the ring that `reach` ends in: by less than one cell this
    moves some of them, and the rings further in hold what they would without them.
    """
    width, beyond = 2 * half + 1, far > reach
    cells = np.empty(len(points), np.int32)
    highest = np.full(width * width, -np.inf, np.float32)
    lowest = np.full(width * width, np.inf, np.float32)
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        if not (abs(x) <= far and abs(y) <= far and z <= ceiling):  # also true of what is not a number
            cells[n] = -1
            continue
        c = (half + int(np.rint(x / side))) * width + half + int(np.rint(y / side))
        if beyond and (abs(x) > reach or abs(y) > reach):
            c = _further_out(c, x, y, half, last, reach)
        cells[n] = c
        highest[c] = max(highest[c], z)  # faster than branches, which are hard to foresee here
        lowest[c] = min(lowest[c], z)
    return cells, highest.reshape(width, width), lowest.reshape(width, width)


@njit(nogil=True)
def _further_out(c, x, y, half, last, reach):  # type: ignore[no-untyped-def]
    """Cell of a point beyond `reach` whose own is `c`: no further in than the ring after `last`."""
    width = 2 * half + 1
    i, j = c // width - half, c % width - half
    if abs(x) > reach and abs(i) == last:
        i += 1 if x > 0 else -1
    if abs(y) > reach and abs(j) == last:
        j += 1 if y > 0 else -1
    return (half + i) * width + half + j


@njit(nogil=True)
def _spread(highest, lowest, half, max_span, max_rise, empty_height):  # type: ignore[no-untyped-def]
    """Which cells are obstacles: ground height spread over square rings from the centre cell outwards."""
    width = 2 * half + 1
    ground = np.empty((width, width), np.float32)
    obstacle = np.zeros((width, width), np.bool_)
    ground[half, half] = highest[half, half] if np.isfinite(highest[half, half]) else empty_height
    for r in range(1, half + 1):
        first, last = half - r, half + r
        inner, outer = first + 1, last - 1  # the previous ring reaches from the one to the other
        # Neighbours in the previous ring, of a side without its ends: three cells in a row.  At the ends there are
        # fewer, so that the nearest is counted twice.
        for i, inside in ((first, inner), (last, outer)):
            for j in range(first, last + 1):
                a, b, c = max(min(j - 1, outer), inner), max(min(j, outer), inner), max(min(j + 1, outer), inner)
                nearby = max(ground[inside, a], ground[inside, b], ground[inside, c])
                _decide(ground, obstacle, highest, lowest, i, j, nearby, max_span, max_rise)
        for i in range(inner, last):
            a, c = max(i - 1, inner), min(i + 1, outer)
            for j, inside in ((first, inner), (last, outer)):
                nearby = max(ground[a, inside], ground[i, inside], ground[c, inside])
                _decide(ground, obstacle, highest, lowest, i, j, nearby, max_span, max_rise)
    return obstacle


@njit(nogil=True)
def _decide(ground, obstacle, highest, lowest, i, j, nearby, max_span, max_rise):  # type: ignore[no-untyped-def]
    """Ground height and verdict of one cell, from its points and the ground `nearby` one ring further in."""
    top = highest[i, j]
    seen = top > -np.inf
    level = (top - lowest[i, j] < max_span) & (top - np.float64(nearby) < max_rise)
    ground[i, j] = top if seen & level else nearby
    obstacle[i, j] = seen & ~level


@njit(nogil=True)
def _gather(obstacle_cell, cells):  # type: ignore[no-untyped-def]
    """The cells' verdict for every point; points that take no part are no obstacles."""
    out = np.zeros(len(cells), np.bool_)
    for n in range(len(cells)):
        if cells[n] >= 0:
            out[n] = obstacle_cell[cells[n]]
    return out
