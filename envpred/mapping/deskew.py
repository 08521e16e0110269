"""Deskewing: a scanner that moves while it turns sees a bent world, which poses and the points' times straighten."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from envpred.compiled import njit
from envpred.mapping.geometry import FloatArray
from envpred.mapping.trajectory import interval_of, poses_at


def deskew(
    points: NDArray[np.float32], when: FloatArray, at: float, times: FloatArray, poses: FloatArray
) -> NDArray[np.float32]:
    """`points` (N, >=3) of one sweep as a sensor that stood where it was at the time `at` would have seen them.

    The sensor is taken to move and turn evenly between poses (Vizzo et al. 2023, section III-A).

    Args:
        points: each in the sensor frame at its own time, metres; further columns are kept.
        when: (N,) time of each point in seconds.
        at: time in seconds that the scan is to be of.
        times: (M,) times of the poses in seconds, increasing, around the sweep; beyond them the last motion goes on.
        poses: (M, 4, 4) of the sensor in the world.
    """
    if not len(points) or len(times) < 2:
        return points.copy()
    to_sensor = np.linalg.inv(poses_at(np.array([at]), times, poses)[0])
    seen: FloatArray = to_sensor @ poses  # from where the sensor is at the time `at`: small numbers
    k, share = interval_of(np.asarray(when, np.float64), times)
    turn = Rotation.from_matrix(seen[:-1, :3, :3].transpose(0, 2, 1) @ seen[1:, :3, :3]).as_rotvec()
    out = points.copy()
    _move(out, k, share, seen, turn, np.diff(seen[:, :3, 3], axis=0))
    return out


def since_start(points: NDArray[np.float32], period: float, clockwise: bool = True, start: float = np.pi) -> FloatArray:
    """Seconds (N,) since a sweep of `period` seconds began, for scanners that say no time, from the points' azimuths.

    Args:
        points: (N, >=3) in the sensor frame.
        period: of a turn, in seconds.
        clockwise: the way that the scanner turns, seen from above.
        start: azimuth at which a sweep begins, radians counter-clockwise from ahead.
    """
    turned = np.arctan2(points[:, 1], points[:, 0]).astype(np.float64) - start
    passed: FloatArray = np.mod(-turned if clockwise else turned, 2 * np.pi) * (period / (2 * np.pi))
    return passed


@njit(nogil=True)
def _move(points: Any, interval: Any, share: Any, poses: Any, turn: Any, step: Any) -> None:
    """Move every point with the sensor's motion: turned by Rodrigues' formula, shifted, and taken into one frame."""
    for n in range(len(points)):
        k, s = interval[n], share[n]
        x, y, z = np.float64(points[n, 0]), np.float64(points[n, 1]), np.float64(points[n, 2])
        rx, ry, rz = turn[k, 0], turn[k, 1], turn[k, 2]
        length = np.sqrt(rx * rx + ry * ry + rz * rz)
        if length > 1e-12:
            rx, ry, rz = rx / length, ry / length, rz / length
            c, i = np.cos(s * length), np.sin(s * length)
            along = (rx * x + ry * y + rz * z) * (1 - c)
            x, y, z = (
                c * x + i * (ry * z - rz * y) + along * rx,
                c * y + i * (rz * x - rx * z) + along * ry,
                c * z + i * (rx * y - ry * x) + along * rz,
            )
        for row in range(3):
            points[n, row] = (
                poses[k, row, 0] * x + poses[k, row, 1] * y + poses[k, row, 2] * z + poses[k, row, 3] + s * step[k, row]
            )
