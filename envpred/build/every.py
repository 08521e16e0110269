"""Every second scan of a drive, or every n-th: a drive of 20 Hz as one of 10 Hz."""

from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from envpred.drives import Drive
from envpred.drives.tracklets import Tracklet
from envpred.mapping.geometry import FloatArray


def thinned(drive: Drive, n: int) -> Drive:
    """Every `n`-th scan of `drive` as a drive of its own."""
    return drive if n == 1 else EveryNth(drive, n)


class EveryNth(Drive):
    """Those frames of `drive` whose numbers are the first one's plus multiples of `n`."""

    def __init__(self, drive: Drive, n: int) -> None:
        self.drive, self.n, self.name = drive, n, drive.name
        self.body, self.sensor_height = drive.body, drive.sensor_height
        self.grid, self.context, self.estimated_by = drive.grid, drive.context, drive.estimated_by

    @property
    def stride(self) -> int:
        return self.n * self.drive.stride

    @cached_property
    def frames(self) -> list[int]:
        frames = self.drive.frames
        return [k for k in frames if (k - frames[0]) % self.stride == 0]

    def scan(self, k: int) -> NDArray[np.float32]:
        return self.drive.scan(k)

    def pose(self, k: int) -> FloatArray:
        return self.drive.pose(k)

    def time(self, k: int) -> float:
        return self.drive.time(k)

    def sensor_to_body(self) -> FloatArray:
        return self.drive.sensor_to_body()

    @property
    def stamped_in(self) -> Path | str:
        return self.drive.stamped_in

    @cached_property
    def speeds(self) -> FloatArray | None:
        speeds = self.drive.speeds
        return None if speeds is None else speeds[np.isin(self.drive.frames, self.frames)]

    def image(self, k: int) -> Path | None:
        return self.drive.image(k)

    @property
    def has_tracklets(self) -> bool:
        return self.drive.has_tracklets

    def tracklets(self) -> list[Tracklet]:
        return self.drive.tracklets()
