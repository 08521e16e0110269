"""Small made-up drives in KITTI's layouts: a street with house fronts, parked cars and traffic, seen by a coarse LiDAR.

    folder = write_drive(tmp_path)                        # a KITTI raw drive of 40 frames
    folder = write_drive(tmp_path, "0002", frames=60, speed=8, missing_scans={20})
    folder = write_sequence(tmp_path)                     # the same motion and scans as a KITTI odometry sequence

A drive of 40 frames takes a few tenths of a second to write and a few milliseconds a frame to map.
"""

from collections.abc import Collection
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

Array = NDArray[np.float64]

DATE = "2011_09_26"
PERIOD = 0.1  # seconds between frames
EARTH_RADIUS = 6378137.0
HOME = (49.0, 8.4)  # latitude and longitude of the first packet, degrees
SENSOR_HEIGHT = 1.73  # above the road, metres
SENSOR_IN_BODY = np.array([0.81, -0.32, 0.80])  # the calibration that is written: no rotation
OXTS_FIELDS = 30


def motion(
    frames: int = 40, speed: float = 5.0, heading: float = 0.0, weave: float = 0.0, period: float = PERIOD
) -> Array:
    """Body poses (T, 4, 4) of a drive along a street at `speed` m/s, swaying by `weave` radians around `heading`."""
    time = period * np.arange(frames)
    yaw = heading + weave * np.sin(time)
    velocity = speed * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    poses = np.tile(np.eye(4), (frames, 1, 1))
    poses[1:, :2, 3] = period * np.cumsum(velocity[:-1], axis=0)
    poses[:, 0, 0], poses[:, 1, 1], poses[:, 1, 0], poses[:, 0, 1] = np.cos(yaw), np.cos(yaw), np.sin(yaw), -np.sin(yaw)
    return poses


def street(length: float, seed: int = 0) -> tuple[Array, Array]:
    """Boxes (N, 4) as x0, x1, y0, y1 in metres along the street, and their velocities (N, 2) in m/s."""
    random = np.random.default_rng(seed)
    boxes, velocities = [], []
    for side in (-1, 1):
        x = -70.0
        while x < length + 70:
            front, depth = random.uniform(5, 14), random.uniform(8, 11)
            boxes.append((x, x + front, *sorted((side * depth, side * (depth + 6)))))
            if random.random() < 0.6:
                boxes.append((x + 1, x + 5, *sorted((side * 5.2, side * 6.9))))
            x += front + random.uniform(1, 5)
    velocities = [(0.0, 0.0)] * len(boxes)
    traffic = [(14, 6, -2.4), (26, 3, -2.6), (18, -5, 3.2), (40, -8, 3.0), (75, -6, 3.3), (-16, 7, -2.5)]
    for x, vx, y in traffic:
        boxes.append((x, x + 4, y - 0.9, y + 0.9))
        velocities.append((vx, 0.0))
    boxes.append((12, 12.6, -4.6, -4.0))  # somebody who crosses
    velocities.append((0.0, 1.3))
    return np.array(boxes), np.array(velocities)


def scan(body_pose: Array, boxes: Array, heading: float = 0.0, azimuths: int = 360) -> NDArray[np.float32]:
    """Points (N, 4) in the sensor frame: three returns above one another where a ray meets a box, and road before it.

    Args:
        body_pose: (4, 4) in a world in which the street runs towards `heading`.
        boxes: (N, 4) as x0, x1, y0, y1 along the street.
        heading: of the street, radians.
        azimuths: rays around.
    """
    sensor = body_pose[:3, :3] @ SENSOR_IN_BODY + body_pose[:3, 3]
    cos, sin = np.cos(heading), np.sin(heading)
    along = np.array([cos * sensor[0] + sin * sensor[1], cos * sensor[1] - sin * sensor[0]])
    turn = np.arctan2(body_pose[1, 0], body_pose[0, 0]) - heading
    azimuth = 2 * np.pi * (np.arange(azimuths) + 0.5) / azimuths
    ray = np.stack([np.cos(azimuth + turn), np.sin(azimuth + turn)], axis=1)[:, None]
    # Slabs: a ray is in a box between the last side it enters and the first it leaves.
    sides = (boxes.reshape(-1, 2, 2) - along[:, None]) / ray[..., None]
    enter, leave = sides.min(axis=-1).max(axis=-1), sides.max(axis=-1).min(axis=-1)
    reached = np.where((enter < leave) & (enter > 0), enter, np.inf).min(axis=1)
    cos_a, sin_a = np.cos(azimuth), np.sin(azimuth)
    walls = [(reached, above) for above in (0.2, 0.9, 1.6)]
    roads = [(np.where(ring < reached, ring, np.inf), 0.0) for ring in (3.0, 4.5, 6.5, 9.5, 14.0, 21.0, 29.0)]
    returns = [
        np.stack([distance * cos_a, distance * sin_a, np.full(azimuths, above), 0 * azimuth], axis=1)
        for distance, above in walls + roads
    ]
    points = np.concatenate(returns)
    points = points[np.hypot(points[:, 0], points[:, 1]) < 60] - (0, 0, SENSOR_HEIGHT, 0)
    rounded: NDArray[np.float32] = points.round(2).astype(np.float32)
    return rounded


def scans(
    poses: Array, heading: float = 0.0, azimuths: int = 360, seed: int = 0, period: float = PERIOD
) -> list[NDArray[np.float32]]:
    """One scan for each of the body `poses` (T, 4, 4), while the traffic moves."""
    boxes, velocities = street(float(np.linalg.norm(poses[-1, :2, 3])), seed)
    steps = period * velocities.repeat(2, axis=1)
    return [scan(pose, boxes + t * steps, heading, azimuths) for t, pose in enumerate(poses)]


def write_drive(
    root: Path,
    number: str = "0001",
    *,
    frames: int = 40,
    speed: float = 5.0,
    heading: float = 0.0,
    weave: float = 0.0,
    azimuths: int = 360,
    seed: int = 0,
    missing_scans: Collection[int] = (),
    missing_packets: Collection[int] = (),
    blank_stamps: bool = True,
    calibration: bool = True,
    images: bool = False,
    period: float = PERIOD,
) -> Path:
    """Write one KITTI raw drive under `root` and return its folder `<date>/<date>_drive_<number>_sync`.

    Args:
        root: holds the folder of the date.
        number: of the drive.
        frames: counted before anything goes missing.
        speed: of the ego, m/s.
        heading: of the street, radians from east.
        weave: of the ego, radians.
        azimuths: rays a scan; 360 give about 2000 points.
        seed: of the houses and parked cars.
        missing_scans: frames without a scan.
        missing_packets: frames without an OXTS packet.
        blank_stamps: whether what is missing leaves an empty line in its timestamps, as KITTI does, else a filled one.
        calibration: whether the day has a calib_imu_to_velo.txt.
        images: whether to add small pictures of camera 2.
        period: seconds between frames.
    """
    folder = root / DATE / f"{DATE}_drive_{number}_sync"
    poses = motion(frames, speed, heading, weave, period)
    for part, missing in (("velodyne_points", missing_scans), ("oxts", missing_packets)):
        (folder / part / "data").mkdir(parents=True)
        _write_stamps(folder / part / "timestamps.txt", frames, missing if blank_stamps else (), period)
    for k, points in enumerate(scans(poses, heading, azimuths, seed, period)):
        if k not in missing_scans:
            points.tofile(folder / "velodyne_points" / "data" / f"{k:010d}.bin")
        if k not in missing_packets:
            (folder / "oxts" / "data" / f"{k:010d}.txt").write_text(packet(poses[k]) + "\n")
    if calibration:
        write_calibration(folder.parent)
    if images:
        (folder / "image_02" / "data").mkdir(parents=True)
        for k in range(frames):
            Image.new("RGB", (12, 4), (k, 0, 0)).save(folder / "image_02" / "data" / f"{k:010d}.png")
    return folder


def write_calibration(day: Path) -> Path:
    """Write the day's calib_imu_to_velo.txt, without rotation, and return it."""
    file = day / "calib_imu_to_velo.txt"
    rotation, translation = np.eye(3).ravel(), -SENSOR_IN_BODY
    file.write_text(f"calib_time: 25-May-2012 16:47:16\nR: {_numbers(rotation)}\nT: {_numbers(translation)}\n")
    return file


def packet(pose: Array) -> str:
    """One OXTS line of 30 fields for a body pose without roll and pitch, the inverse of pykitti's Mercator."""
    latitude, longitude = HOME
    scale = np.cos(np.radians(latitude)) * EARTH_RADIUS
    mercator = np.log(np.tan(np.radians(90 + latitude) / 2)) + pose[1, 3] / scale
    fields = np.zeros(OXTS_FIELDS)
    fields[0] = np.degrees(2 * np.arctan(np.exp(mercator))) - 90
    fields[1] = longitude + np.degrees(pose[0, 3] / scale)
    fields[2] = 112.8 + pose[2, 3]
    fields[5] = np.arctan2(pose[1, 0], pose[0, 0])
    return _numbers(fields[:25]) + " 4 10 4 4 0"


def write_sequence(
    root: Path, number: str = "00", *, frames: int = 40, speed: float = 5.0, weave: float = 0.0, azimuths: int = 360
) -> Path:
    """Write the motion and scans of `write_drive` as an odometry sequence, and return `sequences/<number>`."""
    folder = root / "sequences" / number
    (folder / "velodyne").mkdir(parents=True)
    poses = motion(frames, speed, 0.0, weave)
    sensor = np.eye(4)
    sensor[:3, 3] = SENSOR_IN_BODY
    # KITTI's camera looks along x of the Velodyne: x right, y down, z forward.
    to_camera = np.array([[0, -1, 0, 0.02], [0, 0, -1, -0.08], [1, 0, 0, -0.27], [0, 0, 0, 1]])
    camera_in_body = sensor @ np.linalg.inv(to_camera)
    start = np.linalg.inv(poses[0] @ camera_in_body)
    lines = [_numbers((start @ pose @ camera_in_body)[:3].ravel()) for pose in poses]
    (root / "poses").mkdir(exist_ok=True)
    (root / "poses" / f"{number}.txt").write_text("\n".join(lines) + "\n")
    projections = "".join(f"P{k}: {_numbers(np.eye(3, 4).ravel())}\n" for k in range(4))
    (folder / "calib.txt").write_text(f"{projections}Tr: {_numbers(to_camera[:3].ravel())}\n")
    (folder / "times.txt").write_text("\n".join(f"{PERIOD * k:e}" for k in range(frames)) + "\n")
    for k, points in enumerate(scans(poses, 0.0, azimuths)):
        points.tofile(folder / "velodyne" / f"{k:06d}.bin")
    return folder


def _write_stamps(file: Path, frames: int, blank: Collection[int], period: float) -> None:
    start = datetime(2011, 9, 26, 13, 2, 25, 964389)
    stamps = [start + timedelta(seconds=period) * k for k in range(frames)]
    file.write_text("\n".join("" if k in blank else f"{stamps[k]}445" for k in range(frames)) + "\n", encoding="utf-8")


def _numbers(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)
