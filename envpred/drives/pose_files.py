"""Poses and times as others write them: KITTI's and 4x4 matrices, TUM's quaternions, OXTS packets; lines of stamps."""

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pykitti.utils
from scipy.spatial.transform import Rotation

from envpred.drives.kitti import check_packet
from envpred.errors import UserError, short
from envpred.gate import read_text
from envpred.mapping.geometry import FloatArray

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}  # of a unit of time
NUMBERS = {"kitti": 12, "matrix": 16, "tum": 8}  # of a line
MOST_BYTES = 1 << 30  # of a file of poses


def read_poses(file: Path, format_: str) -> tuple[FloatArray | None, FloatArray, list[int] | None]:
    """Times (M,) where the format has some, in its own unit, poses (M, 4, 4), and numbers of frames where it has some.

    Raises:
        UserError: naming the file, and the line that is none.
    """
    if format_ == "oxts":
        return None, *_packets(file)
    rows = _rows(file, NUMBERS[format_])
    if format_ == "tum":
        return rows[:, 0], _of_quaternions(file, rows[:, 1:]), None
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3] = rows[:, :12].reshape(-1, 3, 4)
    if format_ == "matrix" and not np.allclose(rows[:, 12:], [0, 0, 0, 1], atol=1e-6):
        raise UserError(f"{file}: a matrix a line ends in 0 0 0 1; write them row by row")
    return None, poses, None


def read_times(file: Path, unit: str) -> FloatArray:
    """Seconds (T,) of the lines of `file`: a number in `unit`, or a date and time, the first word of a line.

    Raises:
        UserError: naming the file, and the line that is neither.
    """
    lines = [line for line in _lines(file) if not line.startswith("#")]
    return np.array([seconds(line, unit, f"{file}: line {k + 1}") for k, line in enumerate(lines)], np.float64)


def seconds(text: str, unit: str, where: str) -> float:
    """The time that `text` says: a number in `unit`, or a date and time.

    Raises:
        UserError: naming `where` it is from.
    """
    try:
        words = text.split()
        if "-" in words[0][1:] and ":" in text:
            # Nanoseconds are more than datetime reads; microseconds are enough.
            return datetime.fromisoformat(text.strip()[:26]).replace(tzinfo=UTC).timestamp()
        value = float(words[0]) * SECONDS[unit]
        if not np.isfinite(value):
            raise ValueError
        return value
    except (ValueError, IndexError):
        raise UserError(f"{where}: no time ({short(text.strip())}); write one a line, a number or a date") from None


def _lines(file: Path) -> list[str]:
    if file.is_file() and file.stat().st_size > MOST_BYTES:
        raise UserError(f"{file}: {file.stat().st_size >> 20} MiB are no list of poses or times; name the right file")
    return [line for line in read_text(file, "name the right file").splitlines() if line.strip()]


def _rows(file: Path, numbers: int) -> FloatArray:
    """The numbers (M, numbers) of the lines of `file`; `#` begins a comment."""
    rows = []
    for line in _lines(file):
        if line.lstrip().startswith("#"):
            continue
        words = line.replace(",", " ").split()
        try:
            row = [float(word) for word in words]
            if len(row) != numbers or not np.isfinite(row).all():
                raise ValueError
        except ValueError:
            raise UserError(
                f"{file}: a pose is a line of {numbers} numbers, this one has {len(words)} words "
                f"({short(line.strip()[:30])}); mend it, or name another `poses: format`"
            ) from None
        rows.append(row)
    if not rows:
        raise UserError(f"{file}: holds no pose; name the right file")
    return np.array(rows, np.float64)


def _of_quaternions(file: Path, rows: FloatArray) -> FloatArray:
    lengths = np.linalg.norm(rows[:, 3:], axis=1)
    if (np.abs(lengths - 1) > 0.01).any():
        k = int(np.argmax(np.abs(lengths - 1)))
        raise UserError(
            f"{file}: pose {k + 1}: its quaternion has the length {lengths[k]:.4g}, where a rotation's is 1; a line is "
            "t x y z qx qy qz qw"
        )
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3, :3] = Rotation.from_quat(rows[:, 3:]).as_matrix()
    poses[:, :3, 3] = rows[:, :3]
    return poses


def _packets(folder: Path) -> tuple[FloatArray, list[int]]:
    """Poses of the packets in `folder`, or in its `data`, and their numbers."""
    place = folder / "data" if (folder / "data").is_dir() else folder
    files = sorted(file for file in place.glob("*.txt") if file.stem.isdecimal())
    if not files:
        raise UserError(f"{folder}: holds no OXTS packets (0000000000.txt, ...); name the right folder")
    for file in files:
        check_packet(file)
    packets = pykitti.utils.load_oxts_packets_and_poses(files)
    return np.stack([packet.T_w_imu for packet in packets]), [int(file.stem) for file in files]
