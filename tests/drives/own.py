"""Recordings of a car of nobody's: simulated scans from another place, with other beams, as folders with a YAML.

recorded = record(frames=60, beams=32)
folder = write(tmp_path / "mine", recorded)
"""

from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from envpred.mapping.trajectory import poses_at
from envpred.simulate import scene as scenes
from envpred.simulate.lidar import HDL64E, SENSORS, Rings
from envpred.simulate.rays import Target
from envpred.simulate.run import builtin_recording
from envpred.simulate.traffic import Recording

Array = NDArray[np.float64]

PERIOD = 0.1
PLACE = np.array([0.4, -0.3, 1.15])  # of the sensor in the body frame, metres; KITTI's sits elsewhere
BODY_HEIGHT = 0.93  # of the body frame's origin above the road, metres
HEIGHT = BODY_HEIGHT + PLACE[2]
BODY = {"rear": -1.4, "front": 2.9, "half_width": 0.95}


class Recorded(NamedTuple):
    """What was driven and seen.

    Args:
        scans: of each frame points (N, 4) in the sensor frame with reflectance.
        since: of each frame the seconds (N,) since its sweep began.
        body: (T, 4, 4) poses of the body.
        times: (T,) seconds.
        place: of the sensor in the body frame, metres.
    """

    scans: list[NDArray[np.float32]]
    since: list[Array]
    body: Array
    times: Array
    place: Array = PLACE

    @property
    def sensor(self) -> Array:
        """Poses (T, 4, 4) of the sensor."""
        return self.body @ offset(self.place)


def offset(place: Array = PLACE) -> Array:
    """The sensor in the body frame (4, 4)."""
    pose = np.eye(4)
    pose[:3, 3] = place
    return pose


def above_road(place: Array) -> float:
    """Height of a sensor at that place in metres."""
    return float(BODY_HEIGHT + place[2])


@cache
def scene(frames: int, seed: int = 5, town: int = 1, pace: float = 8.0) -> scenes.Scene:
    """A drive through a town, with bends and changes of speed."""
    recording = Recording.load(builtin_recording())
    return scenes.build(recording, town, recording.motions(town), frames, pace, np.random.default_rng(seed))


def sensor_of(beams: int, columns: int) -> HDL64E:
    """A scanner of so many beams with fewer firings a turn, so that tests are fast."""
    angles = tuple(np.degrees(SENSORS[beams].elevation).tolist())
    return Rings(columns=columns, beams=angles)


@cache
def record(
    frames: int = 60, beams: int = 32, columns: int = 720, moves: bool = False, seed: int = 5, town: int = 1,
    pace: float = 8.0, place: tuple[float, float, float] = (0.4, -0.3, 1.15),
) -> Recorded:  # fmt: skip
    """Drive and look; where the sensor `moves` within a sweep, a scan is stamped at its start."""
    world, sensor, mounted = scene(frames, seed, town, pace), sensor_of(beams, columns), offset(np.array(place))
    still, device = world.targets()
    times, random = np.asarray(PERIOD * np.arange(frames), np.float64), np.random.default_rng(0)
    scans, since = [], []
    for k in range(frames):
        moving = world.moving(k)
        firing = None
        if moves:
            when = np.asarray(times[k] + PERIOD * np.arange(columns) / columns, np.float64)
            firing = poses_at(when, times, world.ego.pose) @ mounted
        target = Target(moving, device) if moving else None
        points, _ = sensor.scan(still, target, world.ego.pose[k] @ mounted, random, firing)
        turned = np.mod(np.arctan2(points[:, 1], points[:, 0]).astype(np.float64), 2 * np.pi) / (2 * np.pi)
        scans.append(points)
        since.append(PERIOD * np.floor(turned * columns) / columns)
    return Recorded(scans, since, world.ego.pose, times, np.array(place))


def write(
    folder: Path, recorded: Recorded, ending: str = ".npy", settings: dict[str, Any] | None = None, clock: float = 0.0,
    with_time: bool = False,
) -> Path:  # fmt: skip
    """Write a recording as a folder with scans, TUM's poses of the sensor and times, and its `envpred.yaml`.

    Args:
        folder: that is made.
        recorded: what is written.
        ending: of the scans.
        settings: what the YAML says beside, or instead of, what is true.
        clock: seconds by which the poses' clock is ahead of the scans'.
        with_time: whether points have times.
    """
    (folder / "lidar").mkdir(parents=True)
    for k, (points, since) in enumerate(zip(recorded.scans, recorded.since, strict=True)):
        rows = np.column_stack([points, since]).astype(np.float32) if with_time else points
        write_scan(folder / "lidar" / f"{k:05d}{ending}", rows)
    rows = np.column_stack(
        [
            recorded.times + clock,
            recorded.sensor[:, :3, 3],
            Rotation.from_matrix(recorded.sensor[:, :3, :3]).as_quat(),
        ]
    )
    np.savetxt(folder / "path.txt", rows, "%.9f", header="t x y z qx qy qz qw")
    np.savetxt(folder / "times.txt", recorded.times, "%.9f")
    said = {
        "sensor": {"height": above_road(recorded.place), "place": recorded.place.tolist()},
        "scans": {"folder": "lidar", **({"columns": ["x", "y", "z", "intensity", "time"]} if with_time else {})},
        "poses": {"format": "tum", "file": "path.txt"},
        "times": {"file": "times.txt"},
        "body": BODY,
    }
    (folder / "envpred.yaml").write_text(yaml.safe_dump(said | (settings or {})))
    return folder


def say(folder: Path, **said: Any) -> None:
    """Let the YAML say something else."""
    file = folder / "envpred.yaml"
    file.write_text(yaml.safe_dump({**yaml.safe_load(file.read_text()), **said}))


def kitti(poses: Array) -> str:
    """Poses (T, 4, 4) as KITTI writes them."""
    return "\n".join(" ".join(map(repr, pose[:3].ravel().tolist())) for pose in poses)


def matrix(poses: Array) -> str:
    """Poses (T, 4, 4) as matrices, one a line."""
    return "\n".join(" ".join(map(repr, pose.ravel().tolist())) for pose in poses)


def write_scan(file: Path, rows: NDArray[np.float32]) -> None:
    """Write one scan (N, 4) or (N, 5) in the format of the file's ending, with libraries that are not ours."""
    names = ("x", "y", "z", "intensity", "time")[: rows.shape[1]]
    if file.suffix == ".npy":
        np.save(file, rows)
    elif file.suffix == ".bin":
        rows.tofile(file)
    elif file.suffix == ".pcd":
        from pypcd4.pypcd4 import PointCloud

        PointCloud.from_points(rows, names, (np.float32,) * len(names)).save(file)
    else:
        from plyfile import PlyData, PlyElement

        vertices = np.array([tuple(row) for row in rows], [(name, "<f4") for name in names])
        PlyData([PlyElement.describe(vertices, "vertex")]).write(str(file))
