"""Poses between those that were measured: positions along straight lines, rotations by spherical interpolation."""

import numpy as np
from scipy.spatial.transform import Rotation

from envpred.mapping.geometry import FloatArray


def poses_at(at: FloatArray, times: FloatArray, poses: FloatArray) -> FloatArray:
    """Poses (N, 4, 4) at the times `at` (N,); before the first and after the last the nearest motion goes on.

    Rotations are interpolated as Shoemake (1985) does.

    Args:
        at: seconds.
        times: (M,) seconds, increasing.
        poses: (M, 4, 4) at `times`.
    """
    at = np.asarray(at, np.float64)
    if len(times) == 1:
        return np.repeat(poses, len(at), axis=0)
    k, share = interval_of(at, times)
    turn = Rotation.from_matrix(poses[k, :3, :3].transpose(0, 2, 1) @ poses[k + 1, :3, :3]).as_rotvec()
    found = poses[k].copy()
    found[:, :3, :3] = poses[k, :3, :3] @ Rotation.from_rotvec(share[:, None] * turn).as_matrix()
    found[:, :3, 3] += share[:, None] * (poses[k + 1, :3, 3] - poses[k, :3, 3])
    return found


def interval_of(at: FloatArray, times: FloatArray) -> tuple[np.ndarray[tuple[int], np.dtype[np.intp]], FloatArray]:
    """Between which of the increasing `times` (M,) each of `at` (N,) lies: the one before it, and the share passed."""
    k = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
    share: FloatArray = (at - times[k]) / (times[k + 1] - times[k])
    return k, share


def motions(poses: FloatArray) -> FloatArray:
    """Motions (M - 1, 4, 4) from each of `poses` (M, 4, 4) to the next, seen from the first of the two."""
    steps: FloatArray = np.linalg.inv(poses[:-1]) @ poses[1:]
    return steps
