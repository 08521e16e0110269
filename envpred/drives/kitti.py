"""KITTI raw drives (Geiger et al. 2013), synchronised and rectified, on pykitti.

Scans and OXTS packets are paired by file name, never by counting: 2011_09_26_drive_0009 lacks four scans.
"""

import re
from collections.abc import Iterable
from datetime import UTC, datetime
from functools import cached_property
from itertools import chain
from pathlib import Path

import numpy as np
import pykitti.utils
from numpy.typing import NDArray

from envpred.drives.drive import SETTINGS, Drive, named, read_points
from envpred.drives.plausible import check_rotation
from envpred.drives.tracklets import TRACKLETS, Tracklet, read_tracklets
from envpred.errors import UserError, short
from envpred.gate import read_text
from envpred.mapping.geometry import FloatArray

OXTS_FIELDS = 30
# Fields of a packet, and what they can be; nobody drives where Mercator's projection ends.
RANGES = (
    ("latitude", 0, 85.0, "degrees"),
    ("longitude", 1, 180.0, "degrees"),
    ("altitude", 2, 9000.0, "m"),
    ("roll", 3, np.pi / 2, "radians"),
    ("pitch", 4, np.pi / 2, "radians"),
    ("yaw", 5, 2 * np.pi, "radians"),
    ("velocity to the north", 6, 100.0, "m/s"),
    ("velocity to the east", 7, 100.0, "m/s"),
)
AGAIN = "copy it again, or delete it to leave a gap in the drive"
NOWHERE = 1e-6  # degrees around latitude and longitude 0, which receivers write where they know no position


def find(root: Path) -> list[Drive]:
    """KITTI raw drives at, in, or one date folder below `root`; where a YAML says what a drive is, that holds."""
    places: Iterable[Path] = chain([root], root.glob("*"), root.glob("*/*"))
    drives = (place for place in places if (place / "velodyne_points" / "data").is_dir())
    return [KittiDrive(place) for place in drives if not (place / SETTINGS).exists()]


class KittiDrive(Drive):
    """One folder `<date>_drive_<number>_sync`, with the day's calibration beside it, or beside what it links to."""

    def __init__(self, folder: Path) -> None:
        self.folder = named(folder)
        self.name = self.folder.name

    @cached_property
    def frames(self) -> list[int]:
        return sorted(self._scans.keys() & self._packets.keys())

    def scan(self, k: int) -> NDArray[np.float32]:
        return read_points(self._scans[k])

    def pose(self, k: int) -> FloatArray:
        return self._packets[k][0]

    @property
    def speeds(self) -> FloatArray:
        return np.array([self._packets[k][1] for k in self.frames])

    @property
    def stamped_in(self) -> Path | str:
        files = [self.folder / part / "timestamps.txt" for part in ("velodyne_points", "oxts")]
        return next((file for file in files if file.is_file()), self.name)

    def time(self, k: int) -> float:
        return self._times[k] - self._times[self.frames[0]]

    def sensor_to_body(self) -> FloatArray:
        places = [folder.parent / "calib_imu_to_velo.txt" for folder in (self.folder, self.folder.resolve())]
        file = next((place for place in places if place.is_file()), places[0])
        try:
            calibration = pykitti.utils.read_calib_file(file)
            rotation, translation = calibration["R"].reshape(3, 3), calibration["T"].reshape(3)
            if not (np.isfinite(rotation).all() and np.isfinite(translation).all()):
                raise ValueError
        except OSError:
            raise UserError(
                f"{file}: the day's calibration is missing; unpack {self.name[:10]}_calib.zip there, "
                "or map with --sensor paper for the paper's fixed offset"
            ) from None
        except (KeyError, ValueError, AttributeError):
            raise UserError(f"{file}: no rotation R and translation T of 9 and 3 numbers; copy it again") from None
        check_rotation(file, rotation)
        return np.linalg.inv(pykitti.utils.transform_from_rot_trans(rotation, translation))

    def image(self, k: int) -> Path | None:
        for ending in (".png", ".jpg"):
            file = self.folder / "image_02" / "data" / f"{k:010d}{ending}"
            if file.is_file():
                return file
        return None

    @property
    def has_tracklets(self) -> bool:
        return (self.folder / TRACKLETS).exists()

    def tracklets(self) -> list[Tracklet]:
        return read_tracklets(self.folder / TRACKLETS) if self.has_tracklets else []

    @cached_property
    def _scans(self) -> dict[int, Path]:
        return _numbered(self.folder / "velodyne_points" / "data", ".bin")

    @cached_property
    def _packets(self) -> dict[int, tuple[FloatArray, float]]:
        """Pose and speed (m/s) of every OXTS packet by frame number; the origin is the drive's first packet."""
        files = _numbered(self.folder / "oxts" / "data", ".txt")
        if not files:
            raise UserError(f"{self.folder / 'oxts' / 'data'}: no OXTS packets; unpack the drive's oxts folder there")
        for file in files.values():
            check_packet(file)
        packets = pykitti.utils.load_oxts_packets_and_poses(list(files.values()))
        return {
            k: (data.T_w_imu, float(np.hypot(data.packet.vn, data.packet.ve)))
            for k, data in zip(files, packets, strict=True)
        }

    @cached_property
    def _times(self) -> dict[int, float]:
        """Seconds by frame number, from the scans' time stamps, else the packets', else the nominal 10 Hz."""
        scans, packets = (_timestamps(self.folder / part / "timestamps.txt") for part in ("velodyne_points", "oxts"))
        first = min(chain(scans.values(), packets.values()), default=0.0)
        return {k: scans.get(k, packets.get(k, first + 0.1 * k)) for k in self.frames}


def _numbered(folder: Path, ending: str) -> dict[int, Path]:
    """Files of a folder by the number they are named with, in order."""
    if not folder.is_dir():
        return {}
    files = (file for file in folder.iterdir() if file.suffix == ending and re.fullmatch(r"\d+", file.stem))
    return {int(file.stem): file for file in sorted(files)}


def check_packet(file: Path) -> None:
    """Refuse a packet that cannot be one.

    Raises:
        UserError: naming the file, and the field.
    """
    lines = [line.split() for line in read_text(file, AGAIN).splitlines()]
    fields = lines[0] if len(lines) == 1 else []
    try:
        numbers = np.array(fields, np.float64)
    except ValueError:
        numbers = np.array([np.nan])
    if len(fields) != OXTS_FIELDS or not np.isfinite(numbers).all():
        raise UserError(
            f"{file}: an OXTS packet is a line of {OXTS_FIELDS} numbers, this one has {len(fields)} fields in "
            f"{len(lines)} lines (or some that are none); {AGAIN}"
        )
    for name, field, limit, unit in RANGES:
        if abs(numbers[field]) > limit:
            raise UserError(f"{file}: a {name} of {numbers[field]:.6g} is beyond {limit:.4g} {unit}; {AGAIN}")
    if np.abs(numbers[:2]).max() < NOWHERE:
        raise UserError(
            f"{file}: latitude 0 and longitude 0 are no position; delete the packets without one, to leave gaps in the "
            "drive"
        )


def _timestamps(file: Path) -> dict[int, float]:
    """Seconds by line number; blank lines (frames that were not recorded) are left out."""
    if not file.is_file():
        return {}
    times = {}
    for k, line in enumerate(read_text(file, "copy the file again").splitlines()):
        if not line.strip():
            continue
        try:
            # Nanoseconds are more than datetime reads; microseconds are enough.
            times[k] = datetime.fromisoformat(line.strip()[:26]).replace(tzinfo=UTC).timestamp()
        except ValueError:
            raise UserError(
                f"{file}: line {k + 1} is no time stamp ({short(line.strip())}); copy the file again"
            ) from None
    return times
