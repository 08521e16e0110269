"""Writes a simulated drive in KITTI raw's layout: scans, packets, times, calibration, and the truth beside them."""

from collections.abc import Iterator
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from envpred.drives.drive import SETTINGS
from envpred.drives.tracklets import HIDDEN, TRACKLETS, VISIBLE, Tracklet
from envpred.mapping.trajectory import poses_at
from envpred.simulate import tracklets
from envpred.simulate.ego import IMU_TO_SENSOR, SENSOR_HEIGHT, fix_lags, oxts_packets
from envpred.simulate.lidar import HDL64E
from envpred.simulate.rays import Target
from envpred.simulate.scene import Box, Scene
from envpred.simulate.traffic import RATE

DATE = "2020_01_01"
TRUE_POSES = "poses.txt"  # sensor to world at every scan, a 3 x 4 matrix a line as in KITTI's odometry; OXTS is late


def drive_name(number: int) -> str:
    """Folder name of the simulated drive of a number from 1 on."""
    return f"{DATE}_drive_{number:04d}_sync"


def write_drive(
    folder: Path, scene: Scene, sensor: HDL64E, number: int, rng: np.random.Generator, swept: bool = False
) -> Iterator[int]:
    """Casts and writes a drive's scans one by one into `folder`; yields the number of points of each.

    Where the scans are `swept` the ego moves on while the sensor turns, and an `envpred.yaml` says how to mend that.
    """
    data, truth = folder / "velodyne_points" / "data", folder / "labels"
    packets = folder / "oxts" / "data"
    for place in (data, truth, packets):
        place.mkdir(parents=True)
    start = datetime(2020, 1, 1, 8) + timedelta(minutes=10 * number)
    lags = fix_lags(scene.frames, rng)
    _write_times(folder, start, lags)
    for k, line in enumerate(oxts_packets(scene.ego.earlier(lags), rng)):
        (packets / f"{k:010d}.txt").write_text(line + "\n", encoding="utf-8")
    poses = np.stack([scene.ego.sensor_pose(k) for k in range(scene.frames)])
    np.savetxt(folder / TRUE_POSES, poses[:, :3].reshape(-1, 12), fmt="%.6f")
    (folder / "oxts" / "dataformat.txt").write_text(_DATAFORMAT, encoding="utf-8")

    if swept:
        (folder / SETTINGS).write_text(_SWEPT, encoding="utf-8")
    still, device = scene.targets()
    seen: dict[int, list[Tracklet]] = {}
    for k, pose in enumerate(poses):
        moving = scene.moving(k)
        firing = _firings(poses, sensor, k) if swept else None
        points, words = sensor.scan(still, Target(moving, device) if moving else None, pose, rng, firing, scene.clutter)
        points.tofile(data / f"{k:010d}.bin")
        words.tofile(truth / f"{k:010d}.label")
        _follow(seen, scene.boxes(k), k, np.asarray(np.linalg.inv(pose), np.float64), words)
        yield len(points)
    kept = [t for object_ in seen.values() for whole in object_ if (t := tracklets.trim(whole))]
    tracklets.write(folder / TRACKLETS, kept)


def _firings(poses: NDArray[np.float64], sensor: HDL64E, frame: int) -> NDArray[np.float64]:
    """Poses (columns, 4, 4) of the sensor at every firing of a turn whose middle is the frame's moment."""
    times = np.arange(len(poses), dtype=np.float64) / RATE
    when = times[frame] + (sensor.azimuth / (2 * np.pi) - 0.5) / RATE
    return poses_at(when, times, poses)


def _follow(
    seen: dict[int, list[Tracklet]],
    boxes: list[Box],
    frame: int,
    to_sensor: NDArray[np.float64],
    words: NDArray[np.uint32],
) -> None:
    """Adds a frame's boxes to the tracklets, hidden without a return; what comes back into reach starts another."""
    hit = set(np.flatnonzero(np.bincount(words >> 16)).tolist())
    turn = np.arctan2(to_sensor[1, 0], to_sensor[0, 0])
    for box in boxes:
        mine = seen.setdefault(box.instance, [])
        if not mine or mine[-1].first + len(mine[-1].poses) != frame:
            mine.append(Tracklet(tracklets.kind_of(box.label), box.size, frame))
        x, y, z = to_sensor[:3, :3] @ box.place + to_sensor[:3, 3]
        yaw = (box.heading + turn + np.pi) % (2 * np.pi) - np.pi
        mine[-1].poses.append((float(x), float(y), float(z), float(yaw)))
        mine[-1].occlusion.append(VISIBLE if box.instance in hit else HIDDEN)


def _write_times(folder: Path, start: datetime, lags: NDArray[np.float64]) -> None:
    files = {
        folder / "velodyne_points" / "timestamps_start.txt": np.full(len(lags), -0.5 / RATE),
        folder / "velodyne_points" / "timestamps.txt": np.zeros(len(lags)),
        folder / "velodyne_points" / "timestamps_end.txt": np.full(len(lags), 0.5 / RATE),
        folder / "oxts" / "timestamps.txt": -lags,
    }
    for file, shifts in files.items():
        times = (start + timedelta(seconds=k / RATE + shift) for k, shift in enumerate(shifts.tolist()))
        file.write_text("".join(f"{t:%Y-%m-%d %H:%M:%S.%f}000\n" for t in times), encoding="utf-8")


def write_calibration(folder: Path) -> None:
    """The day's three calibration files: the sensor where the simulation has it, four ideal cameras in KITTI's rig."""
    folder.mkdir(parents=True, exist_ok=True)
    stamp = "calib_time: 01-Jan-2020 08:00:00\n"
    rigid = "R: {}\nT: {}\n"
    imu_to_sensor = rigid.format(_row(np.eye(3)), _row(-IMU_TO_SENSOR))
    (folder / "calib_imu_to_velo.txt").write_text(stamp + imu_to_sensor, encoding="utf-8")
    # The cameras look along x: their x is the sensor's -y, their y its -z; camera 0 is 0.27 m ahead, 0.08 m lower.
    axes = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]], np.float64)
    to_camera = rigid.format(_row(axes), _row(-axes @ np.array([0.27, 0.0, -0.08])))
    (folder / "calib_velo_to_cam.txt").write_text(stamp + to_camera + "delta_f: 0 0\ndelta_c: 0 0\n", encoding="utf-8")
    (folder / "calib_cam_to_cam.txt").write_text(stamp + "corner_dist: 1.000000e-01\n" + _cameras(), encoding="utf-8")


def _cameras() -> str:
    """Four pinhole cameras of 1242 x 375 pixels without distortion, already rectified."""
    lines = []
    for k, right in enumerate((0.0, 0.54, -0.06, 0.48)):  # metres to the right of camera 0
        inner = np.array([[720.0, 0, 621.0], [0, 720.0, 187.5], [0, 0, 1]])
        projection = np.column_stack([inner, inner @ [-right, 0, 0]])
        size = np.array([1242.0, 375.0])
        shift = np.array([-right, 0, 0])
        raw = (("S", size), ("K", inner), ("D", np.zeros(5)), ("R", np.eye(3)), ("T", shift))
        rectified = (("S_rect", size), ("R_rect", np.eye(3)), ("P_rect", projection))
        for name, values in (*raw, *rectified):
            lines.append(f"{name}_{k:02d}: {_row(values)}\n")
    return "".join(lines)


def _row(values: NDArray[np.float64]) -> str:
    return " ".join(f"{v:.6e}" for v in np.ravel(values) + 0.0)


_SWEPT = f"""# Scans as they left the sensor: the ego moved on while it turned.
sensor: {{height: {SENSOR_HEIGHT:.2f}, place: {IMU_TO_SENSOR.tolist()}}}
scans: {{folder: velodyne_points/data}}
times: {{file: velodyne_points/timestamps.txt}}
poses: {{format: oxts, file: oxts, of: body, times: oxts/timestamps.txt}}
deskew: {{by: azimuth, turn: counterclockwise, start: 0, stamp: middle}}
"""

_DATAFORMAT = """lat: latitude, degrees
lon: longitude, degrees
alt: altitude, metres
roll: radians, 0 = level, positive = left side up
pitch: radians, 0 = level, positive = front down
yaw: radians, 0 = east, counter-clockwise
vn: velocity towards north, m/s
ve: velocity towards east, m/s
vf: velocity ahead, parallel to the earth's surface, m/s
vl: velocity to the left, parallel to the earth's surface, m/s
vu: velocity upwards, m/s
ax: specific force along the body's x axis, m/s^2 (gravity included)
ay: the same along its y axis
az: the same along its z axis
af: specific force ahead, parallel to the earth's surface, m/s^2
al: the same to the left
au: the same upwards
wx: angular rate around the body's x axis, rad/s
wy: the same around its y axis
wz: the same around its z axis
wf: angular rate around the direction ahead, rad/s
wl: the same around the direction to the left
wu: the same around the vertical
posacc: accuracy of the position, metres (drawn, not simulated)
velacc: accuracy of the velocity, m/s (drawn, not simulated)
navstat: navigation status
numsats: satellites
posmode: position mode
velmode: velocity mode
orimode: orientation mode
"""
