"""Deskewing: by hand, against a simulated sensor that moves, and what it leaves alone; poses between poses."""

import numpy as np
import pytest

from envpred.mapping.deskew import deskew, since_start
from envpred.mapping.ground_plane import widest_plane
from envpred.mapping.scan_matching import anywhere, flat, match, moved, target
from envpred.mapping.trajectory import motions, poses_at


def pose(x: float, y: float, yaw: float) -> np.ndarray:
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, 0], [0, 0, 0, 1.0]])


def test_by_hand() -> None:
    """2 m east and a quarter turn left within 0.1 s; each point is seen at its own time.

    At 0 s nothing moves it.  At 0.05 s the sensor stands at (1, 0) and looks 45 degrees left: what is sqrt(2) m ahead
    lies at (2, 1).  At 0.1 s it stands at (2, 0) and looks north: what is 1 m to its left lies at (1, 0).
    """
    points = np.array([[1, 2, 3, 0.5], [np.sqrt(2), 0, 0, 0.6], [0, 1, 1, 0.7]], np.float32)
    poses = np.stack([pose(0, 0, 0), pose(2, 0, np.pi / 2)])
    straight = deskew(points, np.array([10.0, 10.05, 10.1]), 10.0, np.array([10.0, 10.1]), poses)
    np.testing.assert_allclose(straight, [[1, 2, 3, 0.5], [2, 1, 0, 0.6], [1, 0, 1, 0.7]], atol=1e-6)
    # As of the end of the sweep: seen from (2, 0) looking north, (2, 1) is 1 m ahead, and (1, 2) 2 m ahead, 1 m left.
    straight = deskew(points, np.array([10.0, 10.05, 10.1]), 10.1, np.array([10.0, 10.1]), poses)
    np.testing.assert_allclose(straight[:, :3], [[2, 1, 3], [1, 0, 0], [0, 1, 1]], atol=1e-6)
    assert points[1, 1] == 0  # the scan itself is left alone


def test_a_sensor_that_moves_sees_what_one_that_stands_does() -> None:
    """Points of a world, seen one after the other along a bend, with poses at other times than the scan's."""
    random = np.random.default_rng(0)
    world = random.uniform(-30, 30, (500, 3))
    times = np.array([-0.07, 0.01, 0.06, 0.13])
    poses = np.stack([pose(10 * t, 3 * t * t, 0.6 * t) for t in times])
    when = random.uniform(0, 0.1, 500)
    there = np.linalg.inv(poses_at(when, times, poses))
    seen = (np.einsum("nij,nj->ni", there[:, :3, :3], world) + there[:, :3, 3]).astype(np.float32)
    now = np.linalg.inv(poses_at(np.array([0.05]), times, poses)[0])
    expected = world @ now[:3, :3].T + now[:3, 3]
    assert np.abs(seen - expected).max() > 0.4
    np.testing.assert_allclose(deskew(seen, when, 0.05, times, poses), expected, atol=1e-4)


def test_nothing_to_straighten() -> None:
    points = np.ones((3, 4), np.float32)
    still = np.stack([pose(5, 1, 1.0)] * 2)
    np.testing.assert_allclose(deskew(points, np.array([0, 0.05, 0.1]), 0.0, np.array([0, 0.1]), still), points)
    np.testing.assert_array_equal(deskew(points, np.zeros(3), 0.0, np.zeros(1), still[:1]), points)
    assert deskew(points[:0], np.zeros(0), 0.0, np.array([0, 0.1]), still).shape == (0, 4)


@pytest.mark.parametrize(
    ("clockwise", "start", "expected"),
    [
        (True, 180.0, [0.5, 0.25, 0.75, 0.0]),
        (False, 180.0, [0.5, 0.75, 0.25, 0.0]),
        (False, 0.0, [0.0, 0.25, 0.75, 0.5]),
    ],
)
def test_times_by_azimuth(clockwise: bool, start: float, expected: list[float]) -> None:
    ahead_left_right_behind = np.array([[1, 0, 0], [0, 1, 0], [0, -1, 0], [-1, 0, 0]], np.float32)
    since = since_start(ahead_left_right_behind, 0.1, clockwise, np.radians(start))
    np.testing.assert_allclose((since + 1e-6) % 0.1 - 1e-6, 0.1 * np.array(expected), atol=1e-6)


def test_poses_between_and_beyond() -> None:
    times, poses = np.array([0.0, 1.0, 3.0]), np.stack([pose(0, 0, 0), pose(2, 0, 0.4), pose(2, 4, 0.4)])
    found = poses_at(np.array([0.5, 2.0, 4.0, -0.5]), times, poses)
    for k, expected in enumerate([pose(1, 0, 0.2), pose(2, 2, 0.4), pose(2, 6, 0.4), pose(-1, 0, -0.2)]):
        np.testing.assert_allclose(found[k], expected, atol=1e-12)
    np.testing.assert_array_equal(poses_at(np.array([7.0]), times[:1], poses[:1]), poses[:1])
    np.testing.assert_allclose(motions(poses)[1], np.linalg.inv(poses[1]) @ poses[2])


def test_matching_finds_how_far_a_scan_moved() -> None:
    """Four walls around, from another place: the motion is found from nothing, to a centimetre."""
    side = np.linspace(-8, 8, 200)
    walls = [(side, 0 * side + 9), (side, 0 * side - 9), (0 * side + 12, side), (0 * side - 7, side)]
    room = np.concatenate([np.column_stack(wall) for wall in walls])
    motion = np.array([1.3, -0.4, 0.05])
    back = pose(*motion)
    there = (np.column_stack([room, 0 * room, np.ones(len(room))])[:, [0, 1, 2, 4]] @ np.linalg.inv(back).T)[:, :2]
    onto = target(flat(room))
    found, cost = match(flat(there), onto, anywhere(flat(there), onto)[None])
    np.testing.assert_allclose(found, motion, atol=0.01)
    assert cost < 0.15
    np.testing.assert_allclose(moved(there, motion), room, atol=1e-9)


def test_the_widest_plane_is_found_whichever_way_it_faces() -> None:
    x, y = np.random.default_rng(0).uniform(-15, 15, (2, 4000))
    floor = np.column_stack([x, y, 0 * x - 1.8]).astype(np.float32)
    wall = np.column_stack([0 * y[:900] + 9, y[:900], np.abs(x[:900])]).astype(np.float32)
    found = widest_plane(np.concatenate([floor, wall]), (0.3, 5.0))
    assert found is not None
    np.testing.assert_allclose([*found.normal, found.distance], [0, 0, 1, 1.8], atol=1e-3)
    assert 0.6 < found.share < 1
    upside_down = widest_plane(np.concatenate([floor, wall]) * np.array([1, -1, -1], np.float32), (0.3, 5.0))
    assert upside_down is not None
    np.testing.assert_allclose(upside_down.normal, [0, 0, -1], atol=1e-3)
    assert widest_plane(floor[:20], (0.3, 5.0)) is None
    assert widest_plane(wall, (0.3, 5.0)) is None
