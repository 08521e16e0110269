"""How far the sensor moved between two scans, by the scans alone: points to lines in the plane (Censi 2008)."""

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from envpred.mapping.geometry import FloatArray

CELL = 0.25  # metres: one point of each
FARTHEST = 40.0  # metres
NEIGHBOURS = 6  # that a line is laid through
GATES = (2.0, 1.0, 1.0, *(0.5,) * 5)  # metres within which points are paired, by iteration
GATE = 1.0  # metres: what is farther away costs no more
KERNEL = 0.1  # metres: what misses by more weighs less
MOST = 800  # points that are laid onto others
COARSE = np.arange(-3.0, 3.1, 0.5)  # metres: where a motion is looked for of which nothing is known


class Target(NamedTuple):
    """Points that others are matched with: a tree of them (M, 2), and the normals (M, 2) of the lines through them."""

    tree: "cKDTree[None]"
    normals: FloatArray

    @property
    def points(self) -> FloatArray:
        """(M, 2) metres."""
        found: FloatArray = self.tree.data
        return found


def flat(points: FloatArray) -> FloatArray:
    """Points (N, >=2) from above: one (M, 2) of each cell, as far as they are matched."""
    near = points[np.hypot(points[:, 0], points[:, 1]) < FARTHEST, :2].astype(np.float64)
    cells, inverse = np.unique(np.floor(near / CELL).astype(np.int64), axis=0, return_inverse=True)
    sums = np.zeros((len(cells), 2))
    np.add.at(sums, inverse.ravel(), near)
    means: FloatArray = sums / np.bincount(inverse.ravel(), minlength=len(cells))[:, None]
    return means


def target(points: FloatArray) -> Target:
    """`points` (M, 2) as others are matched with them."""
    tree = cKDTree(points)
    near = np.asarray(tree.query(points, min(NEIGHBOURS, len(points)))[1])
    around = points[near] - points[near].mean(axis=1, keepdims=True)
    _, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))
    return Target(tree, vectors[:, :, 0])


def match(points: FloatArray, onto: Target, starts: FloatArray) -> tuple[FloatArray, float]:
    """The motion (x, y, yaw) that lays `points` (N, 2) onto others, in metres and radians, and its cost in metres.

    Args:
        points: of the later scan, in its own frame.
        onto: the earlier scan.
        starts: (K, 3) motions to begin from; the one that comes to the lowest cost is taken.
    """
    some = points[:: -(-len(points) // MOST)]
    found = [_refined(some, onto, start) for start in starts]
    return min(found, key=lambda motion_and_cost: motion_and_cost[1])


def anywhere(points: FloatArray, onto: Target) -> FloatArray:
    """The shift without a turn (x, y, 0) that lays `points` (N, 2) best onto others, of a coarse grid of them."""
    some = points[:: -(-len(points) // 300)]
    tried = [np.array([x, y, 0.0]) for x in COARSE for y in COARSE]
    return min(tried, key=lambda motion: _cost(some, onto, motion))


def moved(points: FloatArray, motion: FloatArray) -> FloatArray:
    """`points` (N, 2) turned and shifted by `motion` (x, y, yaw)."""
    c, s = np.cos(motion[2]), np.sin(motion[2])
    out: FloatArray = points @ np.array([[c, s], [-s, c]]) + motion[:2]
    return out


def _refined(points: FloatArray, onto: Target, start: FloatArray) -> tuple[FloatArray, float]:
    """Gauss-Newton steps from `start`, with the weights of a Cauchy kernel."""
    motion = np.array(start, np.float64)
    for gate in GATES:
        here = moved(points, motion)
        away, k = map(np.asarray, onto.tree.query(here, distance_upper_bound=gate))
        paired = np.isfinite(away)
        if paired.sum() < 10:
            break
        here, k = here[paired], k[paired]
        normal = onto.normals[k]
        miss = ((here - onto.points[k]) * normal).sum(axis=1)
        lever = here - motion[:2]
        row = np.column_stack([normal, normal[:, 1] * lever[:, 0] - normal[:, 0] * lever[:, 1]])
        weight = 1 / (1 + (miss / KERNEL) ** 2)
        system = (row * weight[:, None]).T @ row + 1e-6 * np.eye(3)
        motion -= np.linalg.solve(system, (row * weight[:, None]).T @ miss)
    return motion, _cost(points, onto, motion)


def _cost(points: FloatArray, onto: Target, motion: FloatArray) -> float:
    away, _ = onto.tree.query(moved(points, motion), distance_upper_bound=GATE)
    return float(np.minimum(away, GATE).mean())
