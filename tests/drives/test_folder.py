"""Scans and poses of anybody's: formats, axes, pairing and times, as `envpred.yaml` says them."""

import io
import shutil
import tracemalloc
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from envpred.build import jobs
from envpred.build.grids import build
from envpred.drives import estimated, find_drives, one_drive
from envpred.drives import folder as folders
from envpred.drives.clouds import read_cloud
from envpred.drives.plausible import oddities
from envpred.errors import UserError
from envpred.mapping.geometry import Body, GridSpec
from envpred.store import Store
from tests.drives import own, synthetic
from tests.remedies import installs, remedy

FRAMES = 8


@pytest.fixture(scope="module")
def recorded() -> own.Recorded:
    """A few frames of a street, weaving."""
    body = synthetic.motion(FRAMES, speed=5.0, weave=0.3)
    scans = list(synthetic.scans(body, 0.0, 90))
    since = [np.linspace(0, 0.09, len(points)) for points in scans]
    return own.Recorded(scans, since, body, np.asarray(100 + own.PERIOD * np.arange(FRAMES), np.float64))


@pytest.fixture
def folder(recorded: own.Recorded, tmp_path: Path) -> Path:
    return own.write(tmp_path / "mine", recorded)


def say(folder: Path, **said: Any) -> None:
    """Let the YAML say something else."""
    file = folder / "envpred.yaml"
    file.write_text(yaml.safe_dump({**yaml.safe_load(file.read_text()), **said}))


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


def kitti(poses: own.Array) -> str:
    return "\n".join(" ".join(map(repr, pose[:3].ravel().tolist())) for pose in poses)


def matrix(poses: own.Array) -> str:
    return "\n".join(" ".join(map(repr, pose.ravel().tolist())) for pose in poses)


@pytest.mark.parametrize(("format_", "text"), [("kitti", kitti), ("matrix", matrix)])
def test_poses_a_line(folder: Path, recorded: own.Recorded, format_: str, text: Callable[[own.Array], str]) -> None:
    (folder / "poses.txt").write_text(text(recorded.body))
    say(folder, poses={"format": format_, "file": "poses.txt", "of": "body"})
    np.testing.assert_allclose(one_drive(folder).poses, recorded.body)


def test_oxts_packets_are_paired_by_number(folder: Path, recorded: own.Recorded) -> None:
    (folder / "oxts" / "data").mkdir(parents=True)
    for k in range(FRAMES):
        if k != 3:
            (folder / "oxts" / "data" / f"{k:010d}.txt").write_text(synthetic.packet(recorded.body[k]))
    say(folder, poses={"format": "oxts", "file": "oxts"})
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
    (folder / "poses.txt").write_text(kitti(recorded.sensor @ turned))
    scanned = {"folder": "lidar", "axes": ["right", "forward", "up"]}
    say(folder, scans=scanned, poses={"format": "kitti", "file": "poses.txt"})
    drive = one_drive(folder)
    np.testing.assert_allclose(drive.scan(2), recorded.scans[2], atol=1e-5)
    np.testing.assert_allclose(drive.poses, recorded.body, atol=1e-9)
    say(folder, sensor={"height": 2.0, "angles": [0, 10, 0]})
    c, s = np.cos(np.radians(10)), np.sin(np.radians(10))
    (x, y, z), ahead = recorded.scans[2][0, :3], one_drive(folder).scan(2)[0, :3]
    np.testing.assert_allclose(ahead, [c * x + s * z, y, -s * x + c * z], atol=1e-5)  # it looks down by ten degrees


def test_poses_of_a_camera_in_its_own_world(folder: Path, recorded: own.Recorded) -> None:
    camera = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])  # its axes, along the car's
    (folder / "poses.txt").write_text(kitti(camera.T @ recorded.body @ camera))
    axes, world = ["right", "down", "forward"], ["south", "down", "east"]
    said = {"format": "kitti", "file": "poses.txt", "of": "body", "axes": axes, "world": world}
    say(folder, poses=said)
    np.testing.assert_allclose(one_drive(folder).poses, recorded.body, atol=1e-9)
    inverse = np.linalg.inv(camera.T @ recorded.body @ camera)
    inverse[:, :3, 3] *= 1000
    (folder / "poses.txt").write_text(kitti(inverse))
    say(folder, poses={**said, "inverse": True, "scale": 1.0})
    with pytest.raises(UserError, match="no car is that fast"):
        oddities(one_drive(folder), np.eye(4))


def test_poses_at_their_own_times_are_interpolated(folder: Path) -> None:
    """100 Hz of a car that goes round a circle, on a clock that is 0.5 s ahead; scans beyond them have no pose."""
    times = np.arange(100.0, 100.501, 0.01)
    turn = 0.4 * (times - 100)
    places = 10 * np.column_stack([np.sin(turn), 1 - np.cos(turn), 0 * turn])
    quaternions = Rotation.from_euler("z", turn[:, None]).as_quat()
    np.savetxt(folder / "path.txt", np.column_stack([times + 0.5, places, quaternions]), "%.12f")
    say(folder, poses={"format": "tum", "file": "path.txt", "of": "body", "clock": -0.5})
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


def test_times_in_names_files_and_periods(folder: Path, recorded: own.Recorded) -> None:
    say(folder, times={"period": 0.05}, poses={"format": "tum", "file": "path.txt", "times": "times.txt"})
    (folder / "times.txt").write_text("\n".join(f"{0.05 * k:.3f}" for k in range(FRAMES)))
    assert one_drive(folder).period == 0.05
    for k, file in enumerate(sorted((folder / "lidar").iterdir())):
        file.rename(file.with_stem(str(1_600_000_000_000_000_000 + 100_000_000 * k)))
    say(folder, times={"names": True, "unit": "ns"}, poses={"format": "tum", "file": "path.txt"})
    rows = np.loadtxt(folder / "path.txt")
    rows[:, 0] += 1.6e9 - 100
    np.savetxt(folder / "path.txt", rows, "%.9f")
    drive = one_drive(folder)
    assert drive.frames == list(range(FRAMES))
    np.testing.assert_allclose(drive.times, recorded.times - 100, atol=1e-6)
    stamps = [f"2024-05-01 10:00:{k // 10:02d}.{k % 10}00000" for k in range(FRAMES)]
    (folder / "times.txt").write_text("\n".join(stamps))
    (folder / "poses.txt").write_text(kitti(recorded.sensor))
    say(folder, times={"file": "times.txt"}, poses={"format": "kitti", "file": "poses.txt"})
    np.testing.assert_allclose(one_drive(folder).times, recorded.times - 100, atol=1e-6)


def test_lines_are_numbered_like_scans_where_some_are_missing(folder: Path, recorded: own.Recorded) -> None:
    (folder / "lidar" / "00002.npy").unlink()
    (folder / "poses.txt").write_text(kitti(recorded.sensor))
    say(folder, poses={"format": "kitti", "file": "poses.txt"})
    drive = one_drive(folder)
    assert drive.frames == [0, 1, 3, 4, 5, 6, 7]
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
    say(folder, scans={"folder": "lidar", "scale": 0.001})
    scan = one_drive(folder).scan(1)
    np.testing.assert_allclose(scan[:, :3], recorded.scans[1][:, :3], rtol=1e-6)
    assert not scan[:, 3].any()


def test_grid_and_context_of_the_settings_are_built(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        jobs, "in_processes", lambda job, drives, _: ((len(d.frames), job(d, lambda: None)) for d in drives)
    )
    say(folder, grid={"cells": 32, "resolution": 0.5}, context=48)
    build(folder, tmp_path / "grids", workers=1)
    (stored,) = Store(tmp_path / "grids").drives.values()
    assert stored.manifest["lattice"]["resolution"] == 0.5
    assert stored.array("label").shape == (FRAMES, 32, 32)
    assert stored.array("context_label").shape == (FRAMES, 48, 48)
    assert "poses" not in stored.manifest["source"]
    shutil.copytree(folder, tmp_path / "both" / "a")
    shutil.copytree(folder, tmp_path / "both" / "b")
    say(tmp_path / "both" / "b", grid={"cells": 64}, context=None)
    with pytest.raises(UserError, match=r"ask for 32 cells of 0\.5 m and 64 cells of 0\.3333 m, and a") as failure:
        build(tmp_path / "both", tmp_path / "two")
    assert remedy(failure.value) == [["--drives"]]
    build(tmp_path / "both", tmp_path / "two", drives=["b"], workers=1)
    assert Store(tmp_path / "two").drives["b"].array("label").shape == (FRAMES, 64, 64)


def test_poses_are_estimated_and_the_manifest_says_so(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, recorded: own.Recorded
) -> None:
    monkeypatch.setattr(
        jobs, "in_processes", lambda job, drives, _: ((len(d.frames), job(d, lambda: None)) for d in drives)
    )
    true = np.linalg.inv(recorded.sensor[0]) @ recorded.sensor
    monkeypatch.setattr(folders, "estimate", lambda sweeps, _: (true, np.zeros(len(list(sweeps)))))
    say(folder, poses={"format": "kiss-icp"}, grid={"cells": 16})
    told = f"kiss-icp {version('kiss-icp')}"
    np.testing.assert_allclose(one_drive(folder).poses, np.linalg.inv(recorded.body[0]) @ recorded.body, atol=1e-9)
    build(folder, tmp_path / "grids", workers=1)
    (stored,) = Store(tmp_path / "grids").drives.values()
    assert stored.manifest["source"]["poses"] == f"estimated by {told}"
    assert f"mine: nobody measured its poses, which {told} estimated from the scans" in stored.warnings


@pytest.mark.slow
def test_a_path_is_estimated_from_bent_scans(tmp_path: Path) -> None:
    """Deskewed by its own motion, a path of 48 m ends within a metre of the true one."""
    bent = own.record(60, moves=True)
    how = {"by": "time", "stamp": "start"}
    said = {"poses": {"format": "kiss-icp"}, "deskew": how}
    drive = one_drive(own.write(tmp_path / "mine", bent, ".npy", said, with_time=True))
    np.testing.assert_allclose(
        (np.linalg.inv(drive.poses[0]) @ drive.poses)[-1, :3, 3],
        (np.linalg.inv(bent.body[0]) @ bent.body)[-1, :3, 3],
        atol=1.0,
    )


def test_without_the_extra_it_is_named(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def lacking(name: str) -> str:
        raise PackageNotFoundError(name)

    monkeypatch.setattr(estimated, "version", lacking)
    say(folder, poses={"format": "kiss-icp"})
    with pytest.raises(UserError, match="kiss-icp, which is not installed: pip install") as failure:
        find_drives(folder)
    ((command),) = remedy(failure.value)
    assert "kiss-icp" in installs(command)


# --- what is wrong is one line that names the file ------------------------------------------------------------------


def lines(name: str, change: Callable[[list[str]], list[str]]) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        file = folder / name
        file.write_text("\n".join(change(file.read_text().splitlines())))

    return damage


def settings(**said: Any) -> Callable[[Path], None]:
    return lambda folder: say(folder, **said)


def scan(name: str, content: bytes) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        for file in (folder / "lidar").iterdir():
            file.unlink()
        for k in range(FRAMES):
            (folder / "lidar" / f"{k}{name}").write_bytes(content)

    return damage


def saved(points: Any) -> bytes:
    content = io.BytesIO()
    np.save(content, points)
    return content.getvalue()


TUM = {"format": "tum", "file": "path.txt"}
KITTI = {"format": "kitti", "file": "path.txt"}


def sparse(folder: Path) -> None:
    """A file of more than a gibibyte, which takes no place on the disk."""
    with (folder / "big.txt").open("wb") as file:
        file.truncate((1 << 30) + 1)
    say(folder, poses={**KITTI, "file": "big.txt"})


def look(folder: Path) -> None:
    drive = one_drive(folder)
    oddities(drive, drive.sensor_to_body())


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda f: (f / "envpred.yaml").write_text("a: [1"), r"envpred\.yaml: cannot be read as YAML"),
        (lambda f: (f / "envpred.yaml").write_text(""), r"envpred\.yaml: Expected object, got null; mend it"),
        (settings(sensor={"hieght": 2}), r"envpred\.yaml: sensor: Object (missing|contains).*hieght|height"),
        (settings(poses=None), r"envpred\.yaml: says of no poses; .*kiss-icp"),
        (settings(poses={"format": "tum"}), r"envpred\.yaml: poses: poses that are read need their file"),
        (settings(poses={"format": "kitti", "file": "no.txt"}), r"no\.txt: missing; name the right file"),
        (sparse, r"big\.txt: 1024 MiB are no list of poses or times; name the right file"),
        (settings(poses=KITTI), r"path\.txt: a pose is a line of 12 numbers, this one has 8 words"),
        (settings(poses={**TUM, "file": "envpred.yaml"}), r"a pose is a line of 8 numbers"),
        (settings(poses={"format": "oxts", "file": "lidar"}), "lidar: holds no OXTS packets"),
        (settings(poses={**TUM, "world": ["north", "east", "up"]}), r"poses: world: .* mirror the world"),
        (settings(scans={"folder": "lidar", "axes": ["up", "up", "left"]}), "scans: axes: .* right angles"),
        (settings(poses={**TUM, "times": "short.txt"}), r"short\.txt: 1 times for the 8 poses of .*path\.txt"),
        (settings(times={"file": "short.txt"}), r"short\.txt: 1 lines for 8 scans"),
        (settings(times={"file": "words.txt"}), r"words\.txt: line 1: no time \('soon'\)"),
        (settings(times={"names": True, "period": 1.0}), "times: give one of file, names: true and period"),
        (settings(times=None, poses={**TUM, "file": "two.txt"}), r"envpred\.yaml: says of no times; name their file"),
        (settings(scans={"folder": "nowhere"}), "nowhere: no folder of scans"),
        (settings(scans={"folder": "."}), r"mine: holds no scans \(\.bin, \.npy, \.pcd, \.ply\)"),
        (lambda f: (f / "lidar" / "a.ply").write_text(""), r"lidar: holds scans of several kinds \(\.npy, \.ply\)"),
        (settings(scans={"folder": "lidar", "columns": ["x", "y", "w"]}), "scans: columns name no z"),
        (settings(scans={"folder": "lidar", "columns": ["x", "y", "z", "x"]}), "scans: columns name one twice"),
        (settings(scans={"folder": "lidar", "columns": ["x", "y", "z"]}), "an array of 4 columns, where x, y, z are"),
        (settings(scans={"folder": "lidar", "intensity": "gold"}), "has no column gold, only x, y, z, intensity"),
        (settings(deskew={"by": "time"}), "its points have no times; name their column under `scans: time`"),
        (lines("path.txt", lambda rows: rows[:1] + rows[:0:-1]), r"path\.txt: pose 2 is not later than the one before"),
        (lines("path.txt", lambda rows: rows[:1]), r"path\.txt: holds no pose"),
        (lines("path.txt", lambda rows: [*rows[:2], "100.1 0 0 0 0 0 0 7"]), r"path\.txt: pose 2: its quaternion has"),
        (scan(".bin", b"\0" * 24), r"0\.bin: 24 bytes are no whole number of points of 16 bytes"),
        (scan(".npy", saved(np.zeros((4, 4), np.float32))), r"0\.npy: an empty scan"),
        (scan(".npy", saved(np.zeros((4, 2), np.float32))), r"0\.npy: an array of 2 columns"),
        (scan(".npy", saved(np.array([{}]))), r"0\.npy: damaged"),
        (scan(".ply", b"ply\nformat ascii 1.0\nend_header\n"), r"0\.ply: damaged, or no scan"),
        (scan(".ply", b"plx\nend_header\n"), "does not begin with ply"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_one_line(folder: Path, damage: Callable[[Path], object], message: str) -> None:
    (folder / "short.txt").write_text("1.0\n")
    (folder / "words.txt").write_text("soon\n" * FRAMES)
    (folder / "two.txt").write_text("\n".join((folder / "path.txt").read_text().splitlines()[:3]))
    damage(folder)
    with pytest.raises(UserError, match=message) as failure:
        look(folder)
    assert "\n" not in str(failure.value)


def test_a_scan_that_is_taken_away_is_one_line(recorded: own.Recorded, tmp_path: Path) -> None:
    folder = own.write(tmp_path / "mine", recorded, ".bin")
    drive = one_drive(folder)
    first = drive.frames[0]
    for file in (folder / "lidar").iterdir():
        file.unlink()
    with pytest.raises(UserError, match=r"lidar/.*\.bin: cannot be read \(No such file or directory\)"):
        drive.scan(first)


def test_a_matrix_that_ends_otherwise_is_refused(folder: Path, recorded: own.Recorded) -> None:
    (folder / "poses.txt").write_text(matrix(recorded.body.transpose(0, 2, 1)))
    say(folder, poses={"format": "matrix", "file": "poses.txt"})
    with pytest.raises(UserError, match=r"poses\.txt: a matrix a line ends in 0 0 0 1"):
        one_drive(folder).frames  # noqa: B018


def test_points_whose_times_take_too_long_are_refused(recorded: own.Recorded, tmp_path: Path) -> None:
    folder = own.write(tmp_path / "mine", recorded, ".pcd", {"deskew": {"by": "time"}}, with_time=True)
    assert len(one_drive(folder).scan(0))
    slow = recorded._replace(since=[1e3 * since for since in recorded.since])
    folder = own.write(tmp_path / "slow", slow, ".pcd", {"deskew": {"by": "time"}}, with_time=True)
    with pytest.raises(UserError, match=r"its points take 90 s, where scans are 0.1 s apart; mend `deskew: unit`"):
        one_drive(folder).scan(0)


PCD = (
    "VERSION 0.7\nFIELDS {fields}\nSIZE {size}\nTYPE {type}\nCOUNT {count}\n"
    "WIDTH {n}\nHEIGHT 1\nPOINTS {n}\nDATA {data}\n"
)
XYZ = {"fields": "x y z", "size": "4 4 4", "type": "F F F", "count": "1 1 1", "n": "100", "data": "binary"}
PLY = "ply\nformat {format} 1.0\nelement vertex {n}\n{properties}end_header\n"
VERTEX = {"format": "binary_little_endian", "n": "100", "properties": "".join(f"property float {a}\n" for a in "xyz")}


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.pcd", PCD.format(**XYZ | {"n": 9_000_000})),
        ("a.pcd", PCD.format(**XYZ | {"n": 10**12})),
        ("a.pcd", PCD.format(**XYZ | {"n": 9_000_000, "data": "ascii"})),
        ("a.pcd", PCD.format(**XYZ | {"count": f"1 1 {10**9}"})),
        ("a.pcd", PCD.format(**XYZ | {"size": "4 4"})),
        ("a.pcd", PCD.format(**XYZ | {"data": "binary_compressed"}) + "\xff\xff\xff\x3f" * 2),
        ("a.pcd", PCD.format(**XYZ | {"fields": "a b c"}) + "\0" * 1200),
        ("a.pcd", "VERSION 0.7\n" * 10_000),
        ("a.ply", PLY.format(**VERTEX | {"n": 9_000_000})),
        ("a.ply", PLY.format(**VERTEX | {"n": 10**12})),
        ("a.ply", PLY.format(**VERTEX | {"n": 9_000_000, "format": "ascii"})),
        ("a.ply", PLY.format(**VERTEX | {"properties": "property list uint int x\n"}) + "\xff" * 1200),
        ("a.ply", PLY.format(**VERTEX | {"properties": "property float a\n"}) + "\0" * 1200),
        ("a.ply", "ply\n" * 30_000),
    ],
)
def test_a_header_that_promises_too_much_costs_nothing(tmp_path: Path, name: str, content: str) -> None:
    file = tmp_path / name
    file.write_bytes(content.encode("latin-1"))
    tracemalloc.start()
    try:
        with pytest.raises(UserError, match=rf"{name}: ") as failure:
            read_cloud(file)
        assert tracemalloc.get_traced_memory()[1] < 50e6
    finally:
        tracemalloc.stop()
    assert "\n" not in str(failure.value)


def test_a_grid_that_the_command_line_gives_is_taken(folder: Path) -> None:
    from envpred.build.stated import as_stated
    from envpred.mapping.mapper import MappingParameters

    say(folder, grid={"cells": 32}, context=48)
    drives = find_drives(folder)
    given = MappingParameters(GridSpec(64))
    assert as_stated(drives, given, 128) == (given, 128)
