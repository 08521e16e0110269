"""The own vehicle on ground that we know: where its unit and its sensor ride, and how its body leans."""

from pathlib import Path

import numpy as np
import pykitti.utils
import pytest

from envpred.simulate.ego import FIXES, SENSOR_HEIGHT, drive_over, fix_lags, oxts_packets
from envpred.simulate.mesh import FloatArray
from envpred.simulate.traffic import Motion

FRAMES = 60


class Slope:
    """Ground that rises towards the east by `east` and towards the north by `north`."""

    def __init__(self, east: float = 0.0, north: float = 0.0) -> None:
        self.rise = np.array([east, north])

    def height(self, places: FloatArray) -> FloatArray:
        height: FloatArray = places @ self.rise
        return height


class NoSway(np.random.Generator):
    """A generator whose normal numbers are zero: the body does not sway."""

    def __init__(self) -> None:
        super().__init__(np.random.PCG64(0))

    def normal(self, *_: object, size: tuple[int, ...] = (), **__: object) -> FloatArray:  # type: ignore[override]
        return np.zeros(size)


def motion_of(centre: FloatArray, heading: FloatArray) -> Motion:
    speed = np.hypot(*np.gradient(centre, 0.1, axis=0).T)
    return Motion(0, 4.5, 1.8, 0, centre, heading, speed)


def straight(heading: float, speed: FloatArray) -> Motion:
    way = np.cumsum(speed) * 0.1
    return motion_of(np.outer(way, [np.cos(heading), np.sin(heading)]), np.full(len(way), heading))


def drive(motion: Motion, ground: Slope) -> tuple[Motion, FloatArray, FloatArray]:
    ego = drive_over(motion, ground, 20, FRAMES, NoSway())
    return motion, ego.angles, np.stack([ego.sensor_pose(k) for k in range(FRAMES)])


@pytest.mark.parametrize("heading", [0.0, 1.2, -2.5])
def test_the_sensor_rides_over_the_middle_of_the_car(heading: float) -> None:
    motion, angles, sensor = drive(straight(heading, np.full(100, 7.0)), Slope())
    ahead = np.array([np.cos(heading), np.sin(heading)])
    np.testing.assert_allclose(
        sensor[:, :2, 3] - motion.rear_axle[20:80], np.tile(0.81 * ahead, (FRAMES, 1)), atol=1e-9
    )
    np.testing.assert_allclose(sensor[:, 2, 3], SENSOR_HEIGHT)
    np.testing.assert_allclose(angles, np.tile([0, 0, heading], (FRAMES, 1)), atol=1e-9)


@pytest.mark.parametrize(("heading", "pitch", "roll"), [(0.0, -0.06, 0.0), (np.pi / 2, 0.0, -0.06), (np.pi, 0.06, 0.0)])
def test_the_body_lies_as_the_road_does(heading: float, pitch: float, roll: float) -> None:
    """Uphill is nose up, a negative pitch; higher ground on the left is a positive roll (right side down)."""
    _, angles, sensor = drive(straight(heading, np.full(100, 7.0)), Slope(east=np.tan(0.06)))
    np.testing.assert_allclose(angles[:, 1], pitch, atol=1e-4)
    np.testing.assert_allclose(angles[:, 0], roll, atol=1e-4)
    up = sensor[0, :3, 2]
    np.testing.assert_allclose(up, [-np.sin(0.06), 0, np.cos(0.06)], atol=1e-3)


def test_braking_dips_the_nose_and_a_bend_leans_outwards() -> None:
    braking = straight(0.0, np.linspace(20, 0.2, 100))
    assert drive(braking, Slope())[1][20:40, 1] == pytest.approx(0.0045 * 2.0, rel=0.02)
    angle = np.arange(100) * 0.1 * 8 / 20  # 8 m/s on a circle of 20 m to the left
    left = motion_of(20 * np.stack([np.cos(angle), np.sin(angle)], 1), angle + np.pi / 2)
    assert (drive(left, Slope())[1][:, 0] > 0.012).all()  # 3.2 m/s^2 push the right side down


def test_pykitti_gets_back_the_poses_that_went_into_the_packets(tmp_path: Path) -> None:
    angle = np.arange(100) * 0.1 * 9 / 30
    bend = motion_of(30 * np.stack([np.cos(angle), np.sin(angle)], 1) + [250, 400], angle + np.pi / 2)
    ego = drive_over(bend, Slope(0.03, -0.04), 20, FRAMES, np.random.default_rng(0))
    files = [tmp_path / f"{k:010d}.txt" for k in range(FRAMES)]
    for file, line in zip(files, oxts_packets(ego, np.random.default_rng(0)), strict=True):
        file.write_text(line)
    packets = pykitti.utils.load_oxts_packets_and_poses([str(f) for f in files])
    back = np.stack([p.T_w_imu for p in packets])
    np.testing.assert_allclose(back[:, :3, :3], ego.pose[:, :3, :3], atol=1e-9)
    np.testing.assert_allclose(back[:, :3, 3], ego.pose[:, :3, 3] - ego.pose[0, :3, 3], atol=1e-4)
    forward = np.array([p.packet.vf for p in packets])
    np.testing.assert_allclose(forward, 9.0, rtol=0.02)
    assert np.array([p.packet.al for p in packets]) == pytest.approx(2.7, rel=0.05)  # v^2 / r towards the left
    assert np.array([p.packet.wu for p in packets]) == pytest.approx(0.3, rel=0.02)


def test_fixes_are_older_than_their_scans_and_poses_beat_as_kittis_do() -> None:
    """On a circle the body was so much further back on it; the steps of 1 m between fixes beat by a tenth."""
    angle = np.arange(100) * 0.1 * 10 / 30
    bend = motion_of(30 * np.stack([np.cos(angle), np.sin(angle)], 1), angle + np.pi / 2)
    ego = drive_over(bend, Slope(), 20, FRAMES, NoSway())
    lags = fix_lags(FRAMES, np.random.default_rng(0))
    assert lags.min() >= 0
    assert lags.max() < FIXES
    late = ego.earlier(lags)
    turned = angle[20:80] - lags * 10 / 30
    np.testing.assert_allclose(late.angles[:, 2] - np.pi / 2, turned, atol=1e-9)
    at = np.arctan2(*late.pose[:, [1, 0], 3].T) - np.arctan2(*ego.pose[:, [1, 0], 3].T)
    np.testing.assert_allclose((at + np.pi) % (2 * np.pi) - np.pi, -lags * 10 / 30, atol=2e-4)
    steps = np.linalg.norm(np.diff(late.pose[1:-1, :3, 3], axis=0), axis=1) / np.linalg.norm(
        np.diff(ego.pose[1:-1, :3, 3], axis=0), axis=1
    )
    assert set(np.round(steps, 3)) <= {0.966, 0.967, 1.066, 1.067}  # 3.4 ms less, or 6.6 ms more, of 100
    assert len(set(np.round(steps, 1))) == 2
