"""KITTI odometry and SemanticKITTI sequences: `sequences/<number>/velodyne`, `calib.txt`, poses of the left camera.

They have no IMU and no compass: the world here is the level frame of the first scan, its x axis called east, and the
body frame is put where KITTI's IMU sits.
"""

from functools import cached_property
from pathlib import Path
from typing import cast

import numpy as np
import pykitti.utils
from numpy.typing import NDArray

from envpred.drives.drive import Drive, named, read_points
from envpred.drives.plausible import check_rotation
from envpred.errors import UserError
from envpred.mapping.geometry import PAPER_SENSOR_OFFSET, FloatArray


def find(root: Path) -> list[Drive]:
    """Odometry sequences at, in, or below `root` (`sequences/<number>`)."""
    places = [root, *root.glob("*"), *root.glob("sequences/*"), *root.glob("dataset/sequences/*")]
    return [OdometryDrive(p) for p in dict.fromkeys(places) if (p / "velodyne").is_dir()]


class OdometryDrive(Drive):
    """One folder `sequences/<number>`; its poses are `poses.txt` in it or `poses/<number>.txt` two folders up."""

    def __init__(self, folder: Path) -> None:
        self.folder = named(folder)
        self.name = f"sequence_{self.folder.name}"

    @cached_property
    def frames(self) -> list[int]:
        scans = {int(f.stem) for f in (self.folder / "velodyne").glob("*.bin") if f.stem.isdecimal()}
        return sorted(scans & set(range(len(self._body_poses))))

    def scan(self, k: int) -> NDArray[np.float32]:
        return read_points(self.folder / "velodyne" / f"{k:06d}.bin")

    def pose(self, k: int) -> FloatArray:
        pose: FloatArray = self._body_poses[k]
        return pose

    def time(self, k: int) -> float:
        return float(self._times[k] - self._times[self.frames[0]])

    @property
    def stamped_in(self) -> Path | str:
        file = self.folder / "times.txt"
        return file if file.is_file() else self.name

    def image(self, k: int) -> Path | None:
        file = self.folder / "image_2" / f"{k:06d}.png"
        return file if file.is_file() else None

    @cached_property
    def _body_poses(self) -> FloatArray:
        """Body poses (T, 4, 4), from the camera's by the calibration `Tr` (Velodyne to camera)."""
        calibration, poses = self.folder / "calib.txt", self._pose_file()
        try:
            velodyne_to_camera = np.eye(4)
            velodyne_to_camera[:3] = pykitti.utils.read_calib_file(calibration)["Tr"].reshape(3, 4)
        except OSError:
            raise UserError(f"{calibration}: missing; unpack the calibration of the odometry data there") from None
        except (KeyError, ValueError, AttributeError):
            raise UserError(f"{calibration}: no line `Tr:` with 12 numbers; copy it again") from None
        check_rotation(calibration, velodyne_to_camera[:3, :3])
        try:
            camera: FloatArray = np.loadtxt(poses, ndmin=2).reshape(-1, 3, 4)
            if not np.isfinite(camera).all():
                raise ValueError
        except ValueError:
            raise UserError(f"{poses}: a pose has 12 numbers a line; copy it again") from None
        camera = np.concatenate([camera, np.broadcast_to([[[0.0, 0, 0, 1]]], (len(camera), 1, 4))], axis=1)
        sensor = np.linalg.inv(velodyne_to_camera) @ camera @ velodyne_to_camera
        # World: the first body frame, so that positions start at zero.
        return cast(FloatArray, PAPER_SENSOR_OFFSET @ sensor @ np.linalg.inv(PAPER_SENSOR_OFFSET))

    def _pose_file(self) -> Path:
        places = [self.folder / "poses.txt"]
        places += [f.parents[1] / "poses" / f"{f.name}.txt" for f in (self.folder, self.folder.resolve())]
        for place in places:
            if place.is_file():
                return place
        raise UserError(f"{places[0]}: no poses, nor at {places[1]}; sequences without poses cannot be mapped")

    @cached_property
    def _times(self) -> FloatArray:
        file = self.folder / "times.txt"
        if not file.is_file():
            return np.arange(len(self._body_poses), dtype=np.float64) * 0.1
        try:
            times: FloatArray = np.loadtxt(file, ndmin=1)
        except ValueError:
            raise UserError(f"{file}: a line is no number of seconds; copy it again") from None
        if len(times) < len(self._body_poses):
            raise UserError(f"{file}: {len(times)} times for {len(self._body_poses)} poses; copy it again")
        return times
