"""Scans and poses of anybody's: formats, axes, pairing and times, as `envpred.yaml` says them."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from envpred.drives import find_drives, one_drive
from envpred.drives.folder import FolderDrive
from envpred.drives.plausible import oddities
from envpred.errors import UserError
from envpred.mapping.geometry import Body
from tests.drives import own, synthetic
from tests.drives.conftest import FRAMES


@pytest.mark.parametrize("ending", [".bin", ".npy", ".pcd", ".ply"])
def test_every_format_gives_the_same_drive(recorded: own.Recorded, tmp_path: Path, ending: str) -> None:
    own.write(tmp_path / "mine", recorded, ending)
    (drive,) = find_drives(tmp_path)
    assert (drive.name, drive.frames, drive.period) == ("mine", list(range(FRAMES)), 0.1)
    assert (drive.body, drive.sensor_height) == (Body(**own.BODY), own.HEIGHT)
    np.testing.assert_allclose(drive.sensor_to_body(), own.offset())
    np.testing.assert_array_equal(drive.scan(3), recorded.scans[3])
    np.testing.assert_allclose(drive.poses, recorded.body, atol=1e-7)
    np.testing.assert_allclose(drive.times, recorded.times - 100)
    assert oddities(drive, drive.sensor_to_body()) == []


def test_scans_are_read_when_they_are_asked_for(folder: Path) -> None:
    (folder / "lidar" / "00005.npy").write_bytes(b"nothing")
    drive = one_drive(folder)
    assert len(drive.scan(4))
    assert len(drive.poses) == FRAMES
    with pytest.raises(UserError, match=r"00005\.npy: damaged"):
        drive.scan(5)


@pytest.mark.parametrize(("format_", "text"), [("kitti", own.kitti), ("matrix", own.matrix)])
def test_poses_a_line(folder: Path, recorded: own.Recorded, format_: str, text: Callable[[own.Array], str]) -> None:
    (folder / "poses.txt").write_text(text(recorded.body))
    own.say(folder, poses={"format": format_, "file": "poses.txt", "of": "body"})
    np.testing.assert_allclose(one_drive(folder).poses, recorded.body)


def test_oxts_packets_are_paired_by_number(folder: Path, recorded: own.Recorded) -> None:
    (folder / "oxts" / "data").mkdir(parents=True)
    for k in range(FRAMES):
        if k != 3:
            (folder / "oxts" / "data" / f"{k:010d}.txt").write_text(synthetic.packet(recorded.body[k]))
    own.say(folder, poses={"format": "oxts", "file": "oxts"})
    drive = one_drive(folder)
    assert drive.frames == [0, 1, 2, 4, 5, 6, 7]
    assert drive.stretches() == [(0, 3), (3, 4)]
    steps = drive.poses[:, :2, 3] - drive.poses[0, :2, 3]
    np.testing.assert_allclose(steps, (recorded.body[drive.frames] - recorded.body[0])[:, :2, 3], atol=1e-3)


def test_axes_of_scans_and_poses(recorded: own.Recorded, tmp_path: Path) -> None:
    """x right, y forward, z up in scans and poses alike; a tilted mounting is levelled."""
    right = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])  # of the car's axes, along those of the scans
    turned = np.eye(4)
    turned[:3, :3] = right.T
    scans = [np.column_stack([points[:, :3] @ right.T, points[:, 3]]).astype(np.float32) for points in recorded.scans]
    folder = own.write(tmp_path / "mine", recorded._replace(scans=scans))
    (folder / "poses.txt").write_text(own.kitti(recorded.sensor @ turned))
    scanned = {"folder": "lidar", "axes": ["right", "forward", "up"]}
    own.say(folder, scans=scanned, poses={"format": "kitti", "file": "poses.txt"})
    drive = one_drive(folder)
    np.testing.assert_allclose(drive.scan(2), recorded.scans[2], atol=1e-5)
    np.testing.assert_allclose(drive.poses, recorded.body, atol=1e-9)
    own.say(folder, sensor={"height": 2.0, "angles": [0, 10, 0]})
    c, s = np.cos(np.radians(10)), np.sin(np.radians(10))
    (x, y, z), ahead = recorded.scans[2][0, :3], one_drive(folder).scan(2)[0, :3]
    np.testing.assert_allclose(ahead, [c * x + s * z, y, -s * x + c * z], atol=1e-5)  # it looks down by ten degrees


def test_poses_of_a_camera_in_its_own_world(folder: Path, recorded: own.Recorded) -> None:
    camera = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])  # its axes, along the car's
    (folder / "poses.txt").write_text(own.kitti(camera.T @ recorded.body @ camera))
    axes, world = ["right", "down", "forward"], ["south", "down", "east"]
    said = {"format": "kitti", "file": "poses.txt", "of": "body", "axes": axes, "world": world}
    own.say(folder, poses=said)
    np.testing.assert_allclose(one_drive(folder).poses, recorded.body, atol=1e-9)
    inverse = np.linalg.inv(camera.T @ recorded.body @ camera)
    inverse[:, :3, 3] *= 1000
    (folder / "poses.txt").write_text(own.kitti(inverse))
    own.say(folder, poses={**said, "inverse": True, "scale": 0.001})
    np.testing.assert_allclose(one_drive(folder).poses, recorded.body, atol=1e-9)
    own.say(folder, poses={**said, "inverse": True, "scale": 1.0})
    with pytest.raises(UserError, match="no car is that fast"):
        oddities(one_drive(folder), np.eye(4))


def test_poses_at_their_own_times_are_interpolated(folder: Path) -> None:
    """100 Hz of a car that goes round a circle, on a clock that is 0.5 s ahead; scans beyond them have no pose."""
    times = np.arange(100.0, 100.501, 0.01)
    turn = 0.4 * (times - 100)
    places = 10 * np.column_stack([np.sin(turn), 1 - np.cos(turn), 0 * turn])
    quaternions = Rotation.from_euler("z", turn[:, None]).as_quat()
    np.savetxt(folder / "path.txt", np.column_stack([times + 0.5, places, quaternions]), "%.12f")
    own.say(folder, poses={"format": "tum", "file": "path.txt", "of": "body", "clock": -0.5})
    drive = one_drive(folder)
    assert drive.frames == [0, 1, 2, 3, 4, 5]
    angle = 0.4 * 0.2
    np.testing.assert_allclose(drive.pose(2)[:2, 3], [10 * np.sin(angle), 10 * (1 - np.cos(angle))], atol=1e-4)
    np.testing.assert_allclose(drive.pose(2)[:2, 0], [np.cos(angle), np.sin(angle)], atol=1e-9)


def test_poses_have_gaps_where_nothing_is_interpolated(folder: Path) -> None:
    rows = np.loadtxt(folder / "path.txt")
    dense = np.repeat(rows, 20, axis=0)
    dense[:, 0] = rows[0, 0] + 0.005 * np.arange(len(dense))
    np.savetxt(folder / "path.txt", dense[(dense[:, 0] < 100.25) | (dense[:, 0] > 100.35)])
    assert one_drive(folder).frames == [0, 1, 2, 4, 5, 6, 7]
    np.savetxt(folder / "path.txt", dense[(dense[:, 0] < 100.201) | (dense[:, 0] > 100.35)])
    assert one_drive(folder).frames == [0, 1, 2, 4, 5, 6, 7]  # the last before it was taken with a scan
    np.savetxt(folder / "path.txt", rows[2:3])
    assert one_drive(folder).frames == [2]


def test_times_in_names_files_and_periods(folder: Path, recorded: own.Recorded) -> None:
    own.say(folder, times={"period": 0.05}, poses={"format": "tum", "file": "path.txt", "times": "times.txt"})
    (folder / "times.txt").write_text("\n".join(f"{0.05 * k:.3f}" for k in range(FRAMES)))
    assert one_drive(folder).period == 0.05
    for k, file in enumerate(sorted((folder / "lidar").iterdir())):
        file.rename(file.with_stem(str(1_600_000_000_000_000_000 + 100_000_000 * k)))
    own.say(folder, times={"names": True, "unit": "ns"}, poses={"format": "tum", "file": "path.txt"})
    rows = np.loadtxt(folder / "path.txt")
    rows[:, 0] += 1.6e9 - 100
    np.savetxt(folder / "path.txt", rows, "%.9f")
    drive = one_drive(folder)
    assert drive.frames == list(range(FRAMES))
    np.testing.assert_allclose(drive.times, recorded.times - 100, atol=1e-6)
    stamps = [f"2024-05-01 10:00:{k // 10:02d}.{k % 10}00000" for k in range(FRAMES)]
    (folder / "times.txt").write_text("\n".join(stamps))
    (folder / "poses.txt").write_text(own.kitti(recorded.sensor))
    own.say(folder, times={"file": "times.txt"}, poses={"format": "kitti", "file": "poses.txt"})
    np.testing.assert_allclose(one_drive(folder).times, recorded.times - 100, atol=1e-6)


def test_lines_are_numbered_like_scans_where_some_are_missing(folder: Path, recorded: own.Recorded) -> None:
    (folder / "lidar" / "00002.npy").unlink()
    (folder / "poses.txt").write_text(own.kitti(recorded.sensor))
    own.say(folder, poses={"format": "kitti", "file": "poses.txt"})
    drive = one_drive(folder)
    assert drive.frames == [0, 1, 3, 4, 5, 6, 7]
    assert drive.stretches() == [(0, 2), (2, 5)]
    np.testing.assert_allclose(drive.pose(3), recorded.body[3])
    np.testing.assert_allclose(drive.time(3), 0.3)


def test_what_did_not_return_is_left_out(folder: Path, recorded: own.Recorded) -> None:
    points = np.concatenate([recorded.scans[0], [[np.nan] * 4, [0, 0, 0, 0.5], [np.inf, 1, 1, 0]]]).astype(np.float32)
    np.save(folder / "lidar" / "00000.npy", points)
    np.testing.assert_array_equal(one_drive(folder).scan(0), recorded.scans[0])


def test_scans_in_millimetres_without_reflectance(folder: Path, recorded: own.Recorded) -> None:
    for k, points in enumerate(recorded.scans):
        np.save(folder / "lidar" / f"{k:05d}.npy", 1000 * points[:, :3].astype(np.float64))
    with pytest.raises(UserError, match=r"a coordinate of .* m, where none is beyond 1000 m"):
        one_drive(folder).scan(1)
    own.say(folder, scans={"folder": "lidar", "scale": 0.001})
    scan = one_drive(folder).scan(1)
    np.testing.assert_allclose(scan[:, :3], recorded.scans[1][:, :3], rtol=1e-6)
    assert not scan[:, 3].any()


def test_units_strides_and_clocks_of_times(folder: Path, recorded: own.Recorded) -> None:
    """Poses at milliseconds, scans that are numbered by twos, and a clock of poses without times of their own."""
    rows = np.loadtxt(folder / "path.txt")
    rows[:, 0] *= 1000
    np.savetxt(folder / "ms.txt", rows, "%.9f")
    own.say(folder, poses={"format": "tum", "file": "ms.txt", "unit": "ms"})
    np.testing.assert_allclose(one_drive(folder).poses, recorded.body, atol=1e-6)
    (folder / "poses.txt").write_text(own.kitti(recorded.sensor))
    own.say(folder, poses={"format": "kitti", "file": "poses.txt", "clock": 0.05})
    np.testing.assert_allclose(one_drive(folder).pose(4)[:3, 3], recorded.body[3:5, :3, 3].mean(axis=0), atol=1e-3)
    for file in sorted((folder / "lidar").iterdir(), reverse=True):
        file.rename(file.with_stem(f"{2 * int(file.stem):05d}"))
    own.say(folder, times={"period": 0.1}, poses={"format": "kitti", "file": "poses.txt"})
    drive = one_drive(folder)
    assert drive.frames == list(range(0, 2 * FRAMES, 2))
    np.testing.assert_allclose(drive.times, 0.1 * np.arange(FRAMES))
    assert drive.stretches() == [(0, FRAMES)]


@pytest.mark.parametrize(("stamp", "first"), [("start", 0.0), ("middle", -0.045), ("end", -0.09)])
def test_points_are_timed_from_the_moment_of_the_stamp(
    recorded: own.Recorded, tmp_path: Path, stamp: str, first: float
) -> None:
    said = {"deskew": {"by": "time", "stamp": stamp}}
    drive = one_drive(own.write(tmp_path / "mine", recorded, ".pcd", said, with_time=True))
    assert isinstance(drive, FolderDrive)
    assert drive.said.deskew is not None
    since = drive.scans.since_stamp(drive.sweep(2), drive.said.deskew, drive.period)
    assert (since.min(), since.max()) == pytest.approx((first, first + 0.09), abs=1e-6)


def facing(degrees: float) -> list[float]:
    """Where a body stands that faces so many degrees left of east, as TUM's files have it."""
    return [0, 0, 0, 0, 0, np.sin(np.radians(degrees) / 2), np.cos(np.radians(degrees) / 2)]


@pytest.mark.parametrize(
    ("path", "seen"),
    [
        # North until 0.14 s, north-west from 0.16 s on: the sensor, 1 m ahead of the body, comes from (0, 1) to
        # sqrt(1/2) (-1, 1).  What was 2 m ahead of it, at (0, 3), is then 3 sqrt(1/2) - 1 m ahead and 3 sqrt(1/2) m to
        # the right.
        ([[t / 50, *facing(90 if t <= 7 else 135)] for t in range(16)], (3 * np.sqrt(0.5) - 1, -3 * np.sqrt(0.5))),
        # East at 10 m/s, as two poses a second apart say: 0.6 m further after 0.06 s.
        ([[t, 10 * t, 0, 0, 0, 0, 0, 1] for t in (0, 1)], (1.4, 0)),
    ],
    ids=["dense", "sparse"],
)
def test_a_scan_is_straightened_by_the_poses_around_it(
    tmp_path: Path, path: list[list[float]], seen: tuple[float, float]
) -> None:
    """Of four scans from 0 to 0.3 s the second: the same point twice, at 0.1 s and at 0.16 s."""
    scan = np.array([[2, 0, 0, 0.5], [*seen, 0, 0.5]], np.float32)
    times = np.asarray(0.1 * np.arange(4), np.float64)
    since = np.array([0, 0.06])
    four = own.Recorded([scan] * 4, [since] * 4, np.tile(np.eye(4), (4, 1, 1)), times, np.array([1, 0, 0]))
    folder = own.write(tmp_path / "mine", four, settings={"deskew": {"by": "time", "stamp": "start"}}, with_time=True)
    np.savetxt(folder / "path.txt", path)
    own.say(folder, poses={"format": "tum", "file": "path.txt", "of": "body"})
    np.testing.assert_allclose(one_drive(folder).scan(1)[:, :3], [[2, 0, 0]] * 2, atol=1e-6)


def test_a_reflectance_that_is_none_is_zero(folder: Path, recorded: own.Recorded) -> None:
    points = recorded.scans[0].copy()
    points[:2, 3] = np.nan
    np.save(folder / "lidar" / "00000.npy", points)
    assert one_drive(folder).scan(0)[:2, 3].tolist() == [0, 0]
