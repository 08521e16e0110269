"""The plane that most of what surrounds a sensor lies in, whichever way it faces: the road, if the scan is right."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from envpred.mapping.geometry import FloatArray

NEAR, NEAREST = 20.0, 1.5  # metres from the sensor, between which it is looked for
VOXEL = 0.4  # metres: one point of each, so that dense rings weigh no more than what lies farther away
WITHIN, CLEARLY = 0.15, 0.4  # metres of the plane, and from it
TRIALS = 300


class Plane(NamedTuple):
    """A plane of points p with normal @ p + distance = 0.

    Args:
        normal: (3,) unit vector from the plane towards the sensor.
        distance: of the sensor from it, metres.
        share: of the voxels around the sensor that lie in it.
        beyond: share of them that lie clearly behind it, seen from the sensor.
    """

    normal: FloatArray
    distance: float
    share: float
    beyond: float


def widest_plane(points: NDArray[np.float32], distances: tuple[float, float], seed: int = 0) -> Plane | None:
    """The plane with most of the voxels of a scan, by random sample consensus; None where there is none.

    Args:
        points: (N, >=3) in the sensor frame, metres.
        distances: least and largest that it may have from the sensor, metres: a road's are its height.
        seed: of the samples.
    """
    away = np.linalg.norm(points[:, :3], axis=1)
    near = points[(away < NEAR) & (away > NEAREST), :3].astype(np.float64)
    _, first = np.unique(np.floor(near / VOXEL).astype(np.int64), axis=0, return_index=True)
    near = near[first]
    if len(near) < 50:
        return None
    random = np.random.default_rng(seed)
    a, b, c = near[random.integers(len(near), size=(TRIALS, 3))].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    usable = lengths > 1e-6
    normals = normals[usable] / lengths[usable, None]
    offsets = -(normals * a[usable]).sum(axis=1)
    able = (np.abs(offsets) >= distances[0]) & (np.abs(offsets) <= distances[1])
    if not able.any():
        return None
    normals, offsets = normals[able], offsets[able]
    counts = (np.abs(near @ normals.T + offsets) < WITHIN).sum(axis=0)
    k = int(np.argmax(counts))
    inside = near[np.abs(near @ normals[k] + offsets[k]) < WITHIN]
    centre = inside.mean(axis=0)
    normal = np.linalg.svd(inside - centre, full_matrices=False)[2][2]  # the direction in which they spread least
    distance = -float(normal @ centre)
    if distance < 0:
        normal, distance = -normal, -distance
    height = near @ normal + distance
    return Plane(normal, distance, float((np.abs(height) < WITHIN).mean()), float((height < -CLEARLY).mean()))
