"""The own vehicle: how its body moves on the road, and what its inertial and satellite unit reports of it."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from envpred.simulate.traffic import RATE, Motion

FloatArray = NDArray[np.float64]

# KITTI's car: the unit sits above the rear axle, left of the middle; the sensor as FACTS of the dataset give it.
IMU_LEFT, IMU_HEIGHT = 0.32, 0.93
IMU_TO_SENSOR = np.array([0.81, -0.32, 0.80])
FIXES = 0.01  # seconds between the unit's fixes; a scan gets the last one before it
_SLIP = 0.0034  # seconds by which KITTI's scans, 103.4 ms apart, move on against the fixes
SENSOR_HEIGHT = IMU_HEIGHT + IMU_TO_SENSOR[2]
_WHEELBASE, _TRACK = 2.71, 1.55
_GRAVITY = 9.81
_DIVE, _LEAN = 0.0045, 0.0055  # radians of pitch and roll per m/s^2
_EARTH = 6378137.0
_LATITUDE, _LONGITUDE, _ALTITUDE = 49.0, 8.4, 112.0  # of the network's origin


class Ground(Protocol):
    """What a car can drive on."""

    def height(self, places: FloatArray) -> FloatArray:
        """Height of the ground (...,) at `places` (..., 2), metres."""
        ...


@dataclass(frozen=True)
class EgoMotion:
    """The body's motion, frame by frame; the body frame is the inertial unit's, x forward, y left, z up.

    Attributes:
        pose: (T, 4, 4) body to world (east, north, up; metres, the network's origin).
        angles: (T, 3) roll, pitch, yaw in radians.
        velocity: (T, 3) world, m/s.
        acceleration: (T, 3) world, m/s^2.
        rate: (T, 3) angular velocity in the body frame, rad/s.
    """

    pose: FloatArray
    angles: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    rate: FloatArray

    def sensor_pose(self, k: int) -> FloatArray:
        """(4, 4) sensor to world at frame `k`."""
        shift = np.eye(4)
        shift[:3, 3] = IMU_TO_SENSOR
        pose: FloatArray = self.pose[k] @ shift
        return pose

    def earlier(self, lag: FloatArray) -> "EgoMotion":
        """Where the body was `lag` (T,) seconds before each frame."""

        def back(values: FloatArray) -> FloatArray:
            changed: FloatArray = values - lag[:, None] * np.gradient(values, 1 / RATE, axis=0)
            return changed

        angles, pose = back(self.angles), self.pose.copy()
        pose[:, :3, :3] = _rotation(angles)
        pose[:, :3, 3] -= lag[:, None] * self.velocity
        return EgoMotion(pose, angles, back(self.velocity), back(self.acceleration), back(self.rate))


def drive_over(motion: Motion, terrain: Ground, first: int, frames: int, rng: np.random.Generator) -> EgoMotion:
    """The body's motion over `frames` from position `first` of a track on: wheels on the ground, body on springs."""
    before = min(first, 20)  # frames around the drive that filters and differences look at
    after = min(len(motion.heading) - first - frames, 20)
    part = slice(first - before, first + frames + after)
    yaw, axle = motion.heading[part], motion.rear_axle[part]
    ahead, left = np.stack([np.cos(yaw), np.sin(yaw)], 1), np.stack([-np.sin(yaw), np.cos(yaw)], 1)
    wheel = {
        (x, y): gaussian_filter1d(terrain.height(axle + x * _WHEELBASE * ahead + y * _TRACK / 2 * left), 1.5)
        for x in (0, 1)
        for y in (-1, 1)
    }
    rear, front = (wheel[x, -1] + wheel[x, 1] for x in (0, 1))
    right_side, left_side = (wheel[0, y] + wheel[1, y] for y in (-1, 1))
    flat = np.gradient(axle, 1 / RATE, axis=0)
    push = np.gradient(flat, 1 / RATE, axis=0)
    sway = (
        0.0015
        * gaussian_filter1d(rng.normal(size=(len(yaw), 2)), 2.0, axis=0)
        * 4
        * np.tanh(np.hypot(*flat.T) / 3)[:, None]
    )
    pitch = -np.arctan((front - rear) / (2 * _WHEELBASE)) - _DIVE * (push * ahead).sum(1) + sway[:, 0]
    roll = np.arctan((left_side - right_side) / (2 * _TRACK)) + _LEAN * (push * left).sum(1) + sway[:, 1]
    angles = gaussian_filter1d(np.stack([roll, pitch, yaw], 1), 1.0, axis=0)
    rotation = _rotation(angles)
    place = np.column_stack([axle, rear / 2]) + rotation @ np.array([0, IMU_LEFT, IMU_HEIGHT])

    velocity = np.gradient(place, 1 / RATE, axis=0)
    acceleration = np.gradient(velocity, 1 / RATE, axis=0)
    spin = np.swapaxes(rotation, 1, 2) @ np.gradient(rotation, 1 / RATE, axis=0)
    rate = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], 1)
    pose = np.tile(np.eye(4), (len(yaw), 1, 1))
    pose[:, :3, :3], pose[:, :3, 3] = rotation, place
    keep = slice(before, before + frames)
    return EgoMotion(pose[keep], angles[keep], velocity[keep], acceleration[keep], rate[keep])


def fix_lags(frames: int, rng: np.random.Generator) -> FloatArray:
    """Seconds (T,) by which each scan's fix is older than the scan, as in KITTI: poses beat against the scans."""
    slipped = rng.uniform(0, FIXES) + _SLIP * np.arange(frames, dtype=np.float64)
    return np.asarray(np.mod(slipped, FIXES), np.float64)


def oxts_packets(ego: EgoMotion, rng: np.random.Generator) -> list[str]:
    """The 30 numbers of each OXTS packet as KITTI writes them (Geiger et al. 2013, `dataformat.txt`)."""
    rotation = ego.pose[:, :3, :3]
    level = _rotation(np.column_stack([np.zeros((len(rotation), 2)), ego.angles[:, 2]]))
    to_body, to_level = np.swapaxes(rotation, 1, 2), np.swapaxes(level, 1, 2)
    force = ego.acceleration + np.array([0, 0, _GRAVITY])
    along = (to_level @ ego.velocity[..., None])[..., 0]
    felt, felt_level = (to_body @ force[..., None])[..., 0], (to_level @ force[..., None])[..., 0]
    rate_level = (to_level @ rotation @ ego.rate[..., None])[..., 0]
    yaw = (ego.angles[:, 2] + np.pi) % (2 * np.pi) - np.pi
    latitude, longitude = _geodetic(ego.pose[:, :2, 3])
    numbers = np.column_stack([
        latitude, longitude, _ALTITUDE + ego.pose[:, 2, 3], ego.angles[:, :2], yaw,
        ego.velocity[:, 1], ego.velocity[:, 0], along, felt, felt_level, ego.rate, rate_level,
    ])  # fmt: skip
    accuracy = rng.uniform(0.03, 0.5), rng.uniform(0.02, 0.07)
    tail = f"{accuracy[0]:.6f} {accuracy[1]:.6f} 4 {rng.integers(7, 12)} 4 4 6"
    return [" ".join(f"{v:.14g}" for v in row) + " " + tail for row in numbers]


def _rotation(angles: FloatArray) -> FloatArray:
    """Rotation matrices (T, 3, 3) of roll, pitch, yaw (T, 3): Rz Ry Rx."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(angles.T), np.sin(angles.T)
    return np.stack([
        np.stack([cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr], -1),
        np.stack([sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr], -1),
        np.stack([-sp, cp * sr, cp * cr], -1),
    ], -2)  # fmt: skip


def _geodetic(places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Latitude and longitude in degrees: the inverse of KITTI's Mercator map, which is scaled at the first place."""
    scale = np.cos(np.radians(_LATITUDE))
    for _ in range(20):  # the scale is that of the first packet, which depends on itself
        north = scale * _EARTH * np.log(np.tan(np.pi / 4 + np.radians(_LATITUDE) / 2)) + places[:, 1]
        latitude = 2 * np.arctan(np.exp(north / (scale * _EARTH))) - np.pi / 2
        scale = np.cos(latitude[0])
    longitude = np.radians(_LONGITUDE) + places[:, 0] / (scale * _EARTH)
    return np.degrees(latitude), np.degrees(longitude)
