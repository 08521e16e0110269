"""What every reader gives: a drive's names, times, poses and scans, read when they are asked for."""

import itertools
from abc import ABC, abstractmethod
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from envpred.drives.plausible import check_points
from envpred.drives.tracklets import Tracklet
from envpred.errors import UserError
from envpred.mapping.geometry import PAPER_BODY, PAPER_SENSOR_HEIGHT, PAPER_SENSOR_OFFSET, Body, FloatArray, GridSpec
from envpred.mapping.period import is_gap, nominal

SETTINGS = "envpred.yaml"  # what a user writes about a drive of their own, in its folder


class Drive(ABC):
    """A LiDAR recording: `frames` are the frame numbers that have both a scan and a pose, in order.

    The world's axes are east, north and up, in metres; a pose takes the body (IMU) frame, x forward and y left, to it.
    Car and sensor are KITTI's unless a reader says otherwise.

    Attributes:
        name: of the drive, and of its folder in a store.
        body: the ego vehicle's body in the sensor frame, in metres.
        sensor_height: height of the sensor above the road, in metres.
        grid: that the recording asks to be mapped on, if it does.
        context: cells of the wider grid that it asks for, if it does.
        estimated_by: what its poses were estimated by, where nobody measured them.
    """

    name: str
    body: Body = PAPER_BODY
    sensor_height: float = PAPER_SENSOR_HEIGHT
    grid: GridSpec | None = None
    context: int | None = None
    estimated_by: str | None = None

    @property
    @abstractmethod
    def frames(self) -> list[int]:
        """Frame numbers that have both scan and pose."""

    @abstractmethod
    def scan(self, k: int) -> NDArray[np.float32]:
        """Points (N, 4) of frame `k` in the sensor frame: x, y, z in metres and reflectance.

        Raises:
            UserError: if the file is missing, cut short, empty or holds what cannot be a scan in metres.
        """

    @abstractmethod
    def pose(self, k: int) -> FloatArray:
        """Pose (4, 4) of the body at frame `k`."""

    @abstractmethod
    def time(self, k: int) -> float:
        """Time of frame `k` in seconds since the drive's first frame."""

    def sensor_to_body(self) -> FloatArray:
        """Rigid transform (4, 4) from the sensor frame to the body frame."""
        return PAPER_SENSOR_OFFSET

    def image(self, k: int) -> Path | None:
        """Path of the camera picture of frame `k`, if the drive has one."""
        return None

    @property
    def has_tracklets(self) -> bool:
        """Whether boxes of tracked objects come with the recording, which `tracklets` reads."""
        return False

    def tracklets(self) -> list[Tracklet]:
        """Boxes of tracked objects by frame number, in the sensor frame; none where the recording has none.

        Raises:
            UserError: if they cannot be read.
        """
        return []

    @property
    def stamped_in(self) -> Path | str:
        """Where the times are from: their file, or the drive's name where they have none."""
        return self.name

    @property
    def speeds(self) -> FloatArray | None:
        """Speeds (T,) in m/s of all `frames` that the recording states beside its poses, if it does."""
        return None

    @cached_property
    def poses(self) -> FloatArray:
        """Poses (T, 4, 4) of all `frames`."""
        return np.stack([self.pose(k) for k in self.frames])

    @cached_property
    def times(self) -> FloatArray:
        """Times (T,) of all `frames` in seconds.

        Raises:
            UserError: if they do not increase.
        """
        times = np.array([self.time(k) for k in self.frames], np.float64)
        back = np.flatnonzero(np.diff(times) <= 0)
        if len(back):
            a, b = self.frames[back[0]], self.frames[back[0] + 1]
            raise UserError(
                f"{self.stamped_in}: frame {b} has no later time than frame {a}; mend the drive's time stamps"
            )
        return times

    @cached_property
    def period(self) -> float:
        """Nominal time between frames in seconds, from their stamps; KITTI's 0.1035 s are 10 Hz."""
        return nominal(np.diff(self.times)[np.diff(self.frames) == self.stride])

    @property
    def stride(self) -> int:
        """How much the numbers of frames that follow each other differ."""
        return 1

    def stretches(self) -> list[tuple[int, int]]:
        """Stretches without a gap, as (first, length) in positions of `frames`.

        A gap is a number that is missing, or stamps that differ from the period by more than half of it.
        """
        late = np.array([is_gap(step, self.period) for step in np.diff(self.times)], bool)  # also of a single frame
        breaks = np.flatnonzero((np.diff(self.frames) != self.stride) | late) + 1
        edges = [0, *breaks.tolist(), len(self.frames)]
        return [(a, b - a) for a, b in itertools.pairwise(edges) if b > a]


def named(folder: Path) -> Path:
    """`folder` by an absolute path that ends on its name; a link stays one, as what lies beside it belongs to it."""
    return folder.resolve() if folder.name in ("", "..") else folder.absolute()


def read_points(file: Path) -> NDArray[np.float32]:
    """Points (N, 4) float32 of one `.bin` scan in KITTI's format.

    Raises:
        UserError: if it is missing, cut short, empty or holds what cannot be a scan in metres.
    """
    remedy = "copy it again, or delete it to leave a gap in the drive"
    try:
        size = file.stat().st_size
        if size == 0:
            raise UserError(f"{file}: an empty scan; {remedy}")
        if size % 16:
            raise UserError(
                f"{file}: {size} bytes are no whole number of points of 16 bytes, so it is cut short; {remedy}"
            )
        points = np.fromfile(file, "<f4").reshape(-1, 4)
    except OSError as error:
        raise UserError(f"{file}: cannot be read ({error.strerror}); {remedy}") from None
    check_points(file, points)
    return points
