"""What is wrong in a folder of scans and poses is one line that names the file."""

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from envpred.drives import one_drive
from envpred.drives.plausible import oddities
from envpred.errors import UserError
from tests.drives import own
from tests.drives.conftest import FRAMES


def lines(name: str, change: Callable[[list[str]], list[str]]) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        file = folder / name
        file.write_text("\n".join(change(file.read_text().splitlines())))

    return damage


def settings(**said: Any) -> Callable[[Path], None]:
    return lambda folder: own.say(folder, **said)


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
    own.say(folder, poses={**KITTI, "file": "big.txt"})


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
    (folder / "poses.txt").write_text(own.matrix(recorded.body.transpose(0, 2, 1)))
    own.say(folder, poses={"format": "matrix", "file": "poses.txt"})
    with pytest.raises(UserError, match=r"poses\.txt: a matrix a line ends in 0 0 0 1"):
        one_drive(folder).frames  # noqa: B018


def test_points_whose_times_take_too_long_are_refused(recorded: own.Recorded, tmp_path: Path) -> None:
    folder = own.write(tmp_path / "mine", recorded, ".pcd", {"deskew": {"by": "time"}}, with_time=True)
    assert len(one_drive(folder).scan(0))
    slow = recorded._replace(since=[1e3 * since for since in recorded.since])
    folder = own.write(tmp_path / "slow", slow, ".pcd", {"deskew": {"by": "time"}}, with_time=True)
    with pytest.raises(UserError, match=r"its points take 90 s, where scans are 0.1 s apart; mend `deskew: unit`"):
        one_drive(folder).scan(0)
