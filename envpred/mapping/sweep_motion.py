"""How much of the ego's motion within a sweep is left in the scans: what stands is seen ahead, and later abeam.

A scanner that turns while it moves sees what is beside it earlier or later than what is ahead, so that the same things
come to lie elsewhere once the ego has passed them.  That shift, known but for its size, is fitted to scans some frames
apart, whose nearest points are paired anew in each round.
"""

from typing import NamedTuple

import numpy as np

from envpred.mapping.deskew import deskew, since_start
from envpred.mapping.geometry import FloatArray
from envpred.mapping.scan_matching import KERNEL, moved, target

GATE = 0.5  # metres within which points are paired
ROUNDS, INNER = 6, 5
STEP = 1.5  # of what a round finds, as pairs of nearest points hide a part of it
FEWEST = 200  # pairs that say anything


class View(NamedTuple):
    """One scan from above.

    Args:
        points: (N, 2) of what stands up, in the sensor frame, metres.
        speed: (4, 4) the sensor's motion in one second, seen from where it is.
    """

    points: FloatArray
    speed: FloatArray


def share_left_in(pairs: list[tuple[View, View, FloatArray]], period: float, clockwise: bool) -> float:
    """Share of the motion within a sweep that is left in: 0 if there is none in the scans, 1 if nobody took it out.

    Args:
        pairs: two views each, and the motion (x, y, yaw) from the first to the second.
        period: of a turn in seconds.
        clockwise: the way that the scanner is taken to turn.
    """
    shifts = [(_shift(first, period, clockwise), _shift(second, period, clockwise)) for first, second, _ in pairs]
    share = 0.0
    for _ in range(ROUNDS):
        misses, expected = [np.zeros(0)], [np.zeros(0)]
        for (first, second, motion), (one, other) in zip(pairs, shifts, strict=True):
            onto = target(first.points + share * one)
            here = moved(second.points + share * other, motion)
            away, k = map(np.asarray, onto.tree.query(here, distance_upper_bound=GATE))
            paired = np.isfinite(away)
            k, turned = k[paired], moved(other[paired], np.array([0, 0, motion[2]]))
            misses.append(((here[paired] - onto.points[k]) * onto.normals[k]).sum(axis=1))
            expected.append(((one[k] - turned) * onto.normals[k]).sum(axis=1))
        miss, of_all = np.concatenate(misses), np.concatenate(expected)
        if len(miss) < FEWEST or not of_all.any():
            return 0.0
        share += STEP * _slope(miss, of_all)
    return share


def _shift(view: View, period: float, clockwise: bool) -> FloatArray:
    """How deskewing moves the points (N, 2) of a view."""
    level = np.zeros((len(view.points), 3), np.float32)
    level[:, :2] = view.points
    since = since_start(level, period, clockwise) - period / 2
    motion = np.stack([np.eye(4), view.speed])
    straight = deskew(level, since, 0.0, np.array([0.0, 1.0]), motion)
    shift: FloatArray = (straight - level)[:, :2].astype(np.float64)
    return shift


def _slope(miss: FloatArray, expected: FloatArray) -> float:
    """Slope of `miss` over `expected`, by least squares with a Cauchy kernel."""
    slope = 0.0
    for _ in range(INNER):
        weight = 1 / (1 + ((miss - slope * expected) / KERNEL) ** 2)
        slope = float((weight * miss * expected).sum() / (weight * expected**2).sum())
    return slope
