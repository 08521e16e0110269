"""Recordings of ROS 2 messages, read back by a reader that is not ours."""

import builtins
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.interfaces import ConnectionExtRosbag2
from rosbags.rosbag2.storage_mcap import McapReader

from envpred.drives.tracklets import Tracklet
from envpred.errors import UserError
from envpred.live.mcap import check_extra, nanoseconds, write_recording
from envpred.live.messages import Messages, motion
from envpred.live.occupancy_grid import occupancy_grid
from tests.live.recordings import messages_in, seconds
from tests.remedies import installs, remedy

POSE = np.array([[0.0, -1, 0, 4], [1, 0, 0, 5], [0, 0, 1, 6], [0, 0, 0, 1]])  # a quarter turn to the left


def test_a_grid_comes_back_as_it_went(tmp_path: Path) -> None:
    grid = occupancy_grid(
        np.array([[0.0, 0.1], [0.25, 1.0], [np.nan, 0.5]], np.float32), (4, 6), (100.0, 200.0), 0.5, 2.5, 2.0
    )
    with write_recording(tmp_path / "new" / "grids.mcap") as recording:
        recording.write("/forecast", Messages(recording.types).grid(grid), 2.0, latched=True)
    ((topic, (message,)),) = messages_in(tmp_path / "new" / "grids.mcap").items()
    assert (topic, message.kind, message.time) == ("/forecast", "nav_msgs/msg/OccupancyGrid", 2.0)
    content = message.content
    assert (content.header.frame_id, seconds(content.header.stamp)) == ("map", 2.5)
    assert seconds(content.info.map_load_time) == 2.0
    assert (content.info.width, content.info.height, content.info.resolution) == (3, 2, 0.5)
    assert (content.info.origin.position.x, content.info.origin.position.y) == (101.75, 202.75)
    assert content.info.origin.orientation.w == 1.0
    assert list(content.data) == [0, 25, -1, 10, 100, 50]


def test_who_subscribes_later_gets_what_is_latched(tmp_path: Path) -> None:
    with write_recording(tmp_path / "tf.mcap") as recording:
        messages = Messages(recording.types)
        recording.write("/tf_static", messages.transform(POSE, 1.0, "base_link", "lidar"), 1.0, latched=True)
        recording.write("/tf", messages.transform(POSE, 1.0), 1.0)
    reader = McapReader(tmp_path / "tf.mcap")
    reader.open()
    extra = {connection.topic: connection.ext for connection in reader.connections}
    qos = {topic: ext.offered_qos_profiles[0] for topic, ext in extra.items() if isinstance(ext, ConnectionExtRosbag2)}
    reader.close()
    assert {topic: profile.durability.name for topic, profile in qos.items()} == {
        "/tf_static": "TRANSIENT_LOCAL",
        "/tf": "VOLATILE",
    }
    assert {profile.reliability.name for profile in qos.values()} == {"RELIABLE"}


def test_points_keep_their_truth(tmp_path: Path) -> None:
    scan = np.array([[1, 2, 3, 0.5], [-4, 5, -6, 0.25]], np.float32)
    with write_recording(tmp_path / "points.mcap") as recording:
        messages = Messages(recording.types)
        recording.write("/points", messages.points(scan, 1.5), 1.5)
        recording.write("/points", messages.points(scan, 1.6, np.array([10 | 7 << 16, 252], np.uint32)), 1.6)
    plain, told = (message.content for message in messages_in(tmp_path / "points.mcap")["/points"])
    assert (plain.header.frame_id, plain.width, plain.height, plain.point_step) == ("lidar", 2, 1, 16)
    np.testing.assert_array_equal(np.frombuffer(plain.data, "<f4").reshape(2, 4), scan)
    fields = {field.name: (field.offset, field.datatype) for field in told.fields}
    assert fields == {
        "x": (0, 7),
        "y": (4, 7),
        "z": (8, 7),
        "intensity": (12, 7),
        "label": (16, 4),
        "instance": (18, 4),
    }
    assert told.row_step == 2 * told.point_step == len(told.data) == 40
    words = np.frombuffer(told.data, np.dtype([("xyzi", "<f4", 4), ("label", "<u2"), ("instance", "<u2")]))
    assert words["label"].tolist() == [10, 252]
    assert words["instance"].tolist() == [7, 0]
    np.testing.assert_array_equal(words["xyzi"], scan)


def test_where_the_ego_is_and_how_it_moves(tmp_path: Path) -> None:
    """It faces north and drives north, 2 m in half a second, then as far again."""
    poses = np.stack([POSE, POSE, POSE])
    poses[:, 1, 3] += [0, 2, 4]
    velocity, turn_rate = motion(poses, np.array([0.0, 0.5, 1.0]))
    np.testing.assert_allclose(velocity, [[4, 0, 0]] * 3, atol=1e-12)
    assert turn_rate.tolist() == [0, 0, 0]
    assert motion(poses[:1], np.zeros(1))[0].tolist() == [[0, 0, 0]]
    with write_recording(tmp_path / "ego.mcap") as recording:
        messages = Messages(recording.types)
        recording.write("/odometry", messages.odometry(poses[1], velocity[1], 0.25, 0.5), 0.5)
        recording.write("/tf", messages.transform(poses[1], 0.5), 0.5)
    found = messages_in(tmp_path / "ego.mcap")
    odometry, (transform,) = found["/odometry"][0].content, found["/tf"][0].content.transforms
    assert (odometry.header.frame_id, odometry.child_frame_id) == ("map", "base_link")
    assert (transform.header.frame_id, transform.child_frame_id) == ("map", "base_link")
    assert odometry.pose.pose.position.y == transform.transform.translation.y == 7.0
    turn = odometry.pose.pose.orientation
    np.testing.assert_allclose([turn.x, turn.y, turn.z, turn.w], [0, 0, np.sqrt(0.5), np.sqrt(0.5)], atol=1e-12)
    assert odometry.twist.twist.linear.x == pytest.approx(4)
    assert odometry.twist.twist.angular.z == 0.25


def test_a_turn_rate_goes_on_where_headings_wrap_around() -> None:
    """To the left by 20 degrees in half a second, twice: from 170 over 190, which is -170, to 210 degrees."""
    yaw = np.radians([170, 190, 210])
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 0, 0] = poses[:, 1, 1] = np.cos(yaw)
    poses[:, 1, 0], poses[:, 0, 1] = np.sin(yaw), -np.sin(yaw)
    np.testing.assert_allclose(motion(poses, np.array([0.0, 0.5, 1.0]))[1], np.radians([40] * 3))


def test_boxes_stand_on_the_ground_and_take_the_place_of_those_before(tmp_path: Path) -> None:
    car = Tracklet("Car", (4.0, 2.0, 1.5), 3, [(10.0, 1.0, -1.7, np.pi), (11.0, 1.0, -1.7, np.pi)], [0, 0])
    person = Tracklet("Pedestrian", (0.6, 0.6, 1.8), 4, [(5.0, -3.0, -1.7, 0.0)], [0])
    with write_recording(tmp_path / "boxes.mcap") as recording:
        messages = Messages(recording.types)
        for frame in (2, 3, 4):
            recording.write("/truth/boxes", messages.boxes([car, person], frame, frame / 10), frame / 10)
    arrays = [message.content.markers for message in messages_in(tmp_path / "boxes.mcap")["/truth/boxes"]]
    assert [[(m.ns, m.id, m.action) for m in markers[1:]] for markers in arrays] == [
        [],
        [("Car", 0, 0)],
        [("Car", 0, 0), ("Pedestrian", 1, 0)],
    ]
    assert {markers[0].action for markers in arrays} == {3}  # delete all
    shown: Any = arrays[1][1]
    assert shown.type == 1  # a cube
    assert (shown.header.frame_id, shown.pose.position.x) == ("lidar", 10.0)
    assert shown.pose.position.z == pytest.approx(-1.7 + 0.75)
    assert (shown.scale.x, shown.scale.y, shown.scale.z) == (4.0, 2.0, 1.5)
    assert shown.pose.orientation.z == pytest.approx(1.0)


def test_what_fails_leaves_what_was_there(tmp_path: Path) -> None:
    file = tmp_path / "grids.mcap"
    file.write_bytes(b"before")

    def stopped() -> None:
        with write_recording(file) as recording:
            recording.write("/tf", Messages(recording.types).transform(POSE, 1.0), 1.0)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stopped()
    assert file.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [file]


def test_times_are_microseconds() -> None:
    assert nanoseconds(0.4000000953674316) == 400_000_000
    assert nanoseconds(1317375001.123456) == 1_317_375_001_123_456_000


def test_without_the_extra_it_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *args: Any, **kwargs: Any) -> Any:
        if name.startswith("rosbags"):
            raise ImportError("No module named 'rosbags'")
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(UserError, match=r"writing \.mcap needs an extra .*rosbags") as refused:
        check_extra()
    (command,) = remedy(refused.value)
    assert installs(command) == {"mcap", "rosbags"}
