"""Scans and poses of anybody's: a folder with an `envpred.yaml` that says what they are, see docs/own_data.md.

Whatever the scans' own axes and mounting are, they are given in a frame at the sensor's place whose x points forward,
y left and z up along the body, so that the road is level in it.
"""

from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from envpred.drives.axes import CAR, rotation_of
from envpred.drives.drive import SETTINGS, Drive, named
from envpred.drives.estimated import by_whom, estimate
from envpred.drives.pose_track import PoseTrack
from envpred.drives.scan_folder import ScanFolder, Sweep
from envpred.errors import UserError
from envpred.gate import conform, read_yaml
from envpred.gate.folders import Recording
from envpred.mapping.deskew import deskew
from envpred.mapping.geometry import PAPER_BODY, Body, FloatArray, GridSpec
from envpred.mapping.trajectory import poses_at

REMEDY = "mend it as docs/own_data.md says"
AROUND = 2.0  # periods before and after a scan whose poses straighten it


def find(root: Path) -> list[Drive]:
    """Folders with an `envpred.yaml` at, in, or two folders below `root`."""
    places = [root, *root.glob("*"), *root.glob("*/*")]
    return [FolderDrive(place) for place in places if (place / SETTINGS).is_file()]


class FolderDrive(Drive):
    """One folder with an `envpred.yaml`.

    Raises:
        UserError: naming the YAML, and what in it does not fit.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = named(folder)
        self.name = self.folder.name
        self.settings = self.folder / SETTINGS
        said: Recording = conform(read_yaml(self.settings, REMEDY), Recording, self.settings, REMEDY)
        self.said = said
        self.sensor_height = said.sensor.height
        self.body = PAPER_BODY if said.body is None else Body(said.body.rear, said.body.front, said.body.half_width)
        self.grid = None if said.grid is None else GridSpec(said.grid.cells, said.grid.resolution)
        self.context = said.context
        if said.poses is None:
            raise UserError(
                f"{self.settings}: says of no poses; name their file under `poses`, or write `poses: {{format: "
                "kiss-icp}` to estimate them from the scans"
            )
        self.estimates = said.poses.format == "kiss-icp"
        self.estimated_by = by_whom() if self.estimates else None
        mounting = Rotation.from_euler("xyz", said.sensor.angles, degrees=True).as_matrix()
        levelled: FloatArray = mounting @ rotation_of(said.scans.axes, CAR, self.settings, "scans: axes")
        self.scans = ScanFolder(self.folder / said.scans.folder, said.scans, levelled, self.settings)
        self.track = PoseTrack(self.scans, said.poses, said.times, self.sensor_to_body(), self.settings)

    @cached_property
    def frames(self) -> list[int]:
        if self.estimates:
            return self.scans.numbers
        return [k for k, there in zip(self.scans.numbers, self.track.has_pose, strict=True) if there]

    @property
    def stride(self) -> int:
        return self.scans.stride

    def scan(self, k: int) -> NDArray[np.float32]:
        sweep = self.scans.sweep(k)
        if self.said.deskew is None:
            return sweep.points
        times, poses = self._path
        at = float(self.track.stamps[self.scans.position[k]])
        first, last = np.searchsorted(times, [at - AROUND * self.period, at + AROUND * self.period])
        near = slice(max(int(first) - 1, 0), int(last) + 1)
        when = at + self.scans.since_stamp(sweep, self.said.deskew, self.period)
        return deskew(sweep.points, when, at, times[near], poses[near] @ self.sensor_to_body())

    def pose(self, k: int) -> FloatArray:
        pose: FloatArray = (self._estimated if self.estimates else self.track.poses)[self.scans.position[k]]
        return pose

    def time(self, k: int) -> float:
        stamps, position = self.track.stamps, self.scans.position
        return float(stamps[position[k]] - stamps[position[self.frames[0]]])

    def sensor_to_body(self) -> FloatArray:
        offset = np.eye(4)
        offset[:3, 3] = self.said.sensor.place
        return offset

    @property
    def stamped_in(self) -> Path | str:
        times = self.said.times
        return self.settings if times is None or times.file is None else self.track.inside(times.file)

    def sweep(self, k: int) -> Sweep:
        """The points of frame `k` as they were measured, whatever the ego's motion bent.

        Raises:
            UserError: as for `scan`.
        """
        return self.scans.sweep(k)

    @property
    def _path(self) -> tuple[FloatArray, FloatArray]:
        """Times and poses of the body, as densely as the recording has them."""
        return (self.track.stamps, self._estimated) if self.estimates else self.track.path

    @cached_property
    def _estimated(self) -> FloatArray:
        """Poses of the body at every scan, from the scans alone; the world is its first frame."""
        offset, stamps = self.sensor_to_body(), self.track.stamps
        poses, middles = estimate(map(self._timed, self.frames), self.period)
        return poses_at(stamps, stamps + middles, offset @ poses @ np.linalg.inv(offset))

    def _timed(self, k: int) -> tuple[NDArray[np.float32], FloatArray | None]:
        """Points of frame `k` as they were measured, and their times from the scan's, if they are known."""
        sweep = self.scans.sweep(k)
        how = self.said.deskew
        return sweep.points, None if how is None else self.scans.since_stamp(sweep, how, self.period)
