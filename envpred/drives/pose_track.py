"""Which pose belongs to which scan: by line, by number, or by time with interpolation."""

from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from envpred.drives.axes import CAR, WORLD, rotation_of
from envpred.drives.pose_files import SECONDS, read_poses, read_times, seconds
from envpred.drives.scan_folder import ScanFolder
from envpred.errors import UserError
from envpred.gate.folders import Poses, Times
from envpred.mapping.geometry import FloatArray
from envpred.mapping.trajectory import poses_at

LONGEST_STEP = 5.0  # of the usual time between two poses, beyond which nothing is interpolated
SAME = 1e-6  # seconds


class PoseTrack:
    """The poses of the body that a file says, and the times of the scans.

    Args:
        scans: whose poses they are.
        said: of the poses.
        times: of the scans, if anything is said of them.
        sensor_to_body: (4, 4).
        settings: file that says so; what it names is seen from its folder.
    """

    def __init__(
        self, scans: ScanFolder, said: Poses, times: Times | None, sensor_to_body: FloatArray, settings: Path
    ) -> None:
        self.scans, self.said, self.times, self.settings = scans, said, times, settings
        self.sensor_to_body = sensor_to_body

    @cached_property
    def stamps(self) -> FloatArray:
        """Seconds (T,) of every scan, as the recording counts them.

        Raises:
            UserError: if nothing says them.
        """
        said, scans = self.times, self.scans
        if said is not None and said.names:
            return np.array([seconds(file.stem, said.unit, str(file)) for file in scans.files])
        if said is not None and said.period is not None:
            return np.array(scans.numbers, np.float64) * (said.period / scans.stride)
        if said is not None and said.file is not None:
            times = read_times(self.inside(said.file), said.unit)
            return times[self._line_of_scan(len(times), self.inside(said.file), None)]
        if self.said.file is not None and self._read[0] is not None and len(self._read[0]) == len(scans.files):
            return self._read[0]
        raise UserError(
            f"{self.settings}: says of no times; name their file under `times`, or write `times: {{names: true}}` or "
            "`times: {period: 0.1}`"
        )

    @cached_property
    def path(self) -> tuple[FloatArray, FloatArray]:
        """Times (M,) on the scans' clock and poses (M, 4, 4) of the body, as densely as the recording has them."""
        times, poses, _ = self._read
        if times is None:
            times, poses = self.stamps[self._line >= 0], poses[self._line[self._line >= 0]]
        return times + self.said.clock, poses

    @cached_property
    def has_pose(self) -> NDArray[np.bool_]:
        """Which (T,) of the scans have a pose."""
        if not self._interpolates:
            there: NDArray[np.bool_] = self._line >= 0
            return there
        times = self.path[0]
        if len(times) < 2:
            met: NDArray[np.bool_] = np.abs(self.stamps - times[0]) < SAME
            return met
        steps = np.diff(times)
        step = float(np.median(steps))
        k = np.clip(np.searchsorted(times, self.stamps, side="right") - 1, 0, len(times) - 2)
        inside = (self.stamps >= times[0] - step / 2) & (self.stamps <= times[-1] + step / 2)
        near = (np.abs(self.stamps - times[k]) < SAME) | (steps[k] <= LONGEST_STEP * step)
        found: NDArray[np.bool_] = inside & near
        return found

    @cached_property
    def poses(self) -> FloatArray:
        """Poses (T, 4, 4) of the body at every scan; where there is none, the unit matrix."""
        poses = np.tile(np.eye(4), (len(self.scans.files), 1, 1))
        there = self.has_pose
        poses[there] = poses_at(self.stamps[there], *self.path) if self._interpolates else self.path[1]
        return poses

    @cached_property
    def pose_axes(self) -> FloatArray:
        """Rotation (3, 3) from the axes of what the poses are of to those of the car."""
        if self.said.axes is not None:
            return rotation_of(self.said.axes, CAR, self.settings, "poses: axes")
        return self.scans.levelled if self._of_sensor else np.eye(3)

    @property
    def _of_sensor(self) -> bool:
        return (self.said.of or ("body" if self.said.format == "oxts" else "sensor")) == "sensor"

    @property
    def _interpolates(self) -> bool:
        """Whether scans and poses are taken at different times."""
        return self._read[0] is not None or self.said.clock != 0

    @cached_property
    def _read(self) -> tuple[FloatArray | None, FloatArray, list[int] | None]:
        """Times in seconds where the poses have some, poses of the body, and numbers of frames where they have some."""
        said = self.said
        assert said.file is not None
        file = self.inside(said.file)
        times, poses, numbers = read_poses(file, said.format)
        if times is not None:
            times = times * SECONDS[said.unit]
        if said.times is not None:
            where = self.inside(said.times)
            times = read_times(where, said.unit)
            if len(times) != len(poses):
                raise UserError(
                    f"{where}: {len(times)} times for the {len(poses)} poses of {file}; name the right file"
                )
        if times is not None and (np.diff(times) <= 0).any():
            k = int(np.argmax(np.diff(times) <= 0))
            raise UserError(f"{file}: pose {k + 2} is not later than the one before it; sort them by time")
        return times, self._of_body(poses), numbers

    def _of_body(self, poses: FloatArray) -> FloatArray:
        """`poses` (M, 4, 4) as they stand in their file, as those of the body in a world whose z points up."""
        said, axes = self.said, self.pose_axes
        world = rotation_of(said.world, WORLD, self.settings, "poses: world")
        if said.inverse:
            poses = np.asarray(np.linalg.inv(poses), np.float64)
        moved = np.tile(np.eye(4), (len(poses), 1, 1))
        moved[:, :3, :3] = world @ poses[:, :3, :3] @ axes.T
        moved[:, :3, 3] = said.scale * poses[:, :3, 3] @ world.T
        return moved @ np.linalg.inv(self.sensor_to_body) if self._of_sensor else moved

    @cached_property
    def _line(self) -> NDArray[np.intp]:
        """Which line of the file of poses each scan has; -1 for none."""
        assert self.said.file is not None
        return self._line_of_scan(len(self._read[1]), self.inside(self.said.file), self._read[2])

    def _line_of_scan(self, lines: int, file: Path, numbers: list[int] | None) -> NDArray[np.intp]:
        """Which line of `file` each scan has: by the number in its name, else by its place; -1 for none.

        Raises:
            UserError: if there are neither as many lines as scans, nor numbers of lines in the scans' names.
        """
        scans = self.scans.numbers
        if numbers is not None:
            line_of = {k: n for n, k in enumerate(numbers)}
            return np.array([line_of.get(k, -1) for k in scans], np.intp)
        if lines == len(scans):
            return np.arange(lines)
        if scans[-1] >= lines or scans == list(range(len(scans))):
            raise UserError(
                f"{file}: {lines} lines for {len(scans)} scans, and the scans' names are no numbers of lines; write a "
                "line for each scan, or give times to both"
            )
        return np.array(scans, np.intp)

    def inside(self, place: str) -> Path:
        """A place that the settings name, seen from their folder."""
        return self.settings.parent / place
