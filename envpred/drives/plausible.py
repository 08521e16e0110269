"""What a recording cannot be is refused in one line; what it seldom is comes back as warnings for its manifest."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from envpred.errors import UserError
from envpred.mapping.geometry import FloatArray
from envpred.mapping.period import is_gap

if TYPE_CHECKING:
    from envpred.drives.drive import Drive

FARTHEST = 1000.0  # metres from the sensor: LiDARs on cars see a third of it at most
FASTEST = 100.0  # m/s
LONGEST = 20.0  # metres between sensor and body frame
ROUND = 1e-3  # by which a rotation's rows may miss length one and right angles
PERIODS = (0.01, 2.0)  # seconds between scans
USUAL_PERIODS = (0.04, 0.21)  # LiDARs on cars turn 5 to 20 times a second
SLOW = 2.0  # m/s: below it a stated speed says nothing about time stamps
WRONG_SPEED, ODD_SPEED = 1.5, 1.1  # factor between the speed of the poses and the stated one
ODD_GAPS = 0.2  # share of steps


def check_points(where: Path | str, points: NDArray[np.float32]) -> None:
    """Refuse points (N, 4) that are no scan in metres: not finite, too far away, or of negative reflectance.

    Raises:
        UserError: naming `where` they are from, and the value.
    """
    if not len(points):
        return
    with np.errstate(invalid="ignore"):
        # Of all columns at once: along an axis of four NumPy takes a hundred times as long.
        low, high = float(points.min()), float(points.max())
    if not np.isfinite(low + high):
        raise UserError(
            f"{where}: holds coordinates that are not finite; copy it again, or delete it to leave a gap in the drive"
        )
    if max(-low, high) > FARTHEST:
        farthest = float(np.abs(points[:, :3]).max())
        if farthest > FARTHEST:
            raise UserError(
                f"{where}: a coordinate of {farthest:.4g} m, where none is beyond {FARTHEST:.0f} m; write scans as "
                "little-endian float32 x, y, z in metres and reflectance"
            )
    least = float(points[:, 3].min())
    if least < 0:
        raise UserError(
            f"{where}: a reflectance of {least:.4g}, which cannot be negative; write scans with four columns: x, y, z "
            "in metres and reflectance"
        )


def check_rotation(where: Path | str, rotation: FloatArray) -> None:
    """Refuse a matrix (3, 3) that is no rotation: rows not of length one or not at right angles, or a mirror.

    Raises:
        UserError: naming `where` it is from, and its determinant.
    """
    determinant = float(np.linalg.det(rotation))
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=ROUND) or determinant < 0:
        kind = "mirrors" if np.isclose(determinant, -1, atol=0.01) else "is no rotation"
        raise UserError(f"{where}: its matrix {kind} (determinant {determinant:.3g}, a rotation's is 1); copy it again")


def oddities(drive: "Drive", sensor_to_body: FloatArray) -> list[str]:
    """What is odd about the first scan, the poses and the stamps of `drive`, a line each.

    Args:
        drive: that is to be mapped.
        sensor_to_body: (4, 4) where its sensor is taken to sit.

    Raises:
        UserError: if they cannot be those of a car's drive.
    """
    first = drive.frames[0]
    check_points(f"{drive.name}: frame {first}", drive.scan(first))
    _check_sensor(drive.name, sensor_to_body)
    _check_poses(drive)
    told = _of_stamps(drive)
    if drive.estimated_by:
        told.append(f"{drive.name}: nobody measured its poses, which {drive.estimated_by} estimated from the scans")
    return told


def _check_sensor(name: str, sensor_to_body: FloatArray) -> None:
    check_rotation(f"{name}: sensor", sensor_to_body[:3, :3])
    away = float(np.linalg.norm(sensor_to_body[:3, 3]))
    if not away <= LONGEST:
        raise UserError(f"{name}: its calibration puts the sensor {away:.4g} m away from the body; give metres")


def _check_poses(drive: "Drive") -> None:
    rotations, frames = drive.poses[:, :3, :3], drive.frames
    misses = np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    bad = np.flatnonzero(~(misses <= ROUND) | ~(np.linalg.det(rotations) > 0))
    if len(bad):
        check_rotation(f"{drive.name}: pose of frame {frames[bad[0]]}", rotations[bad[0]])
    steps = np.linalg.norm(np.diff(drive.poses[:, :2, 3], axis=0), axis=1)
    fast = np.flatnonzero(~(steps <= FASTEST * np.diff(drive.times)))
    if len(fast):
        k = int(fast[0])
        raise UserError(
            f"{drive.name}: frame {frames[k + 1]} lies {steps[k]:.4g} m from frame {frames[k]}, "
            f"{drive.times[k + 1] - drive.times[k]:.3g} s before it, and no car is that fast; mend its pose or its "
            "time, or delete its scan to leave a gap"
        )


def _of_stamps(drive: "Drive") -> list[str]:
    told, stamps, period = [], drive.stamped_in, drive.period / drive.stride
    if not PERIODS[0] <= period <= PERIODS[1]:
        raise UserError(
            f"{stamps}: frames {period:.3g} s apart, where a LiDAR takes {PERIODS[0]} to {PERIODS[1]:.0f} s; mend the "
            "time stamps"
        )
    if not USUAL_PERIODS[0] <= period <= USUAL_PERIODS[1]:
        told.append(f"{stamps}: frames {period:.3g} s apart; LiDARs on cars turn 5 to 20 times a second")
    steps, numbers = np.diff(drive.times), np.diff(drive.frames)
    next_to = numbers == drive.stride
    late = np.array([is_gap(step, drive.period) for step in steps[next_to]])
    if late.size and late.mean() > ODD_GAPS:
        told.append(
            f"{stamps}: {late.mean():.0%} of the frames follow the one before at another time than the period of "
            f"{drive.period:.3g} s, so each starts anew"
        )
    stated = drive.speeds
    if stated is not None and next_to.any():
        moved = np.linalg.norm(np.diff(drive.poses[:, :2, 3], axis=0), axis=1)[next_to].sum()
        expected = ((stated[1:] + stated[:-1]) / 2 * steps)[next_to].sum()
        mean = float(expected / steps[next_to].sum())
        factor = float(moved / expected) if expected > 0 else 1.0
        off = max(factor, 1 / max(factor, 1e-9))
        if mean >= SLOW and off > ODD_SPEED:
            line = f"{stamps}: stamps and positions make {factor * mean:.3g} m/s, and the packets say {mean:.3g}"
            if off > WRONG_SPEED:
                raise UserError(f"{line}; mend the time stamps, which make {1 / period:.3g} scans a second")
            told.append(line)
    return told
