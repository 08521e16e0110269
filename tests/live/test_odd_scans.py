"""A stream goes on where scans, stamps or poses are not as they should be, and says so."""

import shutil
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from envpred.drives import Drive, one_drive
from envpred.errors import UserError
from envpred.live.replay import Latency, replay, warmed
from envpred.live.stream import Stream
from envpred.models import LastFrame
from tests.live.streams import GRID, feed, ready


def test_late_and_repeated_scans_are_left_out(drive: Drive) -> None:
    stream, said = ready(drive)
    last = stream.mapped
    for k in (9, 9, 7, 8):
        assert stream.update(drive.scan(k), drive.pose(k), drive.time(k)) is None
    assert said == [
        "the scan at 0.90 s is of the same time as the one before: left out",
        "the scan at 0.70 s is 0.200 s older than the one before: left out",
    ]
    assert stream.mapped is last
    assert stream.update(drive.scan(10), drive.pose(10), 0.94) is None
    assert said[2:] == ["the scan at 0.94 s comes 0.040 s after the one before, not 0.1 s: left out"]
    assert stream.update(drive.scan(10), drive.pose(10), drive.time(10)) is not None


def test_evidence_starts_anew_after_a_gap_a_jump_and_a_clock_that_is_set_back(drive: Drive) -> None:
    anew = [False] * 4 + [True] * 2
    for change, line in (
        ({"later": 0.1}, "no scan for 0.20 s before 1.10 s: evidence starts anew"),
        ({"moved": 5.0}, "the pose at 1.00 s has jumped, by 7.5"),
        ({"moved": 1e6}, "the pose at 1.00 s has jumped, by 141421"),
        ({"later": -100.0}, "the clock was set back by 99.90 s to -99.00 s: evidence starts anew"),
    ):
        stream, said = ready(drive)
        assert feed(stream, drive, range(10, 16), **change) == anew
        assert len(said) == 1
        assert said[0].startswith(line)
        assert stream.seen is not None
        assert stream.seen["pose"].abs().max() < 1000  # a lattice near by
        stream, said = ready(drive)
        assert all(feed(stream, drive, range(10, 16)))
        assert not said


def test_who_turns_on_the_spot_has_jumped(drive: Drive) -> None:
    stream, said = ready(drive)
    pose = drive.pose(10).copy()
    pose[:2, :2] = pose[:2, :2] @ np.array([[0, -1], [1, 0]])
    assert stream.update(drive.scan(10), pose, drive.time(10)) is None
    assert " degrees: evidence starts anew" in said[0]


def test_a_scan_without_points_is_a_missing_one(drive: Drive) -> None:
    """Its rays would be taken to meet nothing, and all to be free."""
    stream, said = ready(drive)
    last = stream.mapped
    for empty in (np.empty((0, 4), np.float32), np.full((3, 4), np.nan, np.float32)):
        assert stream.update(empty, drive.pose(10), drive.time(10)) is None
    assert said == [
        "the scan at 1.00 s has no points: left out",
        "3 of 3 points at 1.00 s are not finite, or beyond 1000 m: left out",
    ]
    assert stream.mapped is last
    assert feed(stream, drive, range(11, 17)) == [False] * 4 + [True] * 2
    assert said[2:] == ["no scan for 0.20 s before 1.10 s: evidence starts anew"]


def test_points_that_are_none_are_left_out(drive: Drive) -> None:
    """And what remains is mapped as if they had not been there; columns beyond the third are not needed."""

    def spoilt(points: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
        bad = np.array([[np.nan, 1, 1, 0], [1, np.inf, 1, 0], [5000, 1, 1, 0]], np.float32)
        return np.concatenate([bad, points])[:, :3]

    (stream, said), (clean, _) = ready(drive), ready(drive)
    assert all(feed(stream, drive, range(10, 12), points=spoilt))
    feed(clean, drive, range(10, 12))
    count = len(drive.scan(10))
    assert said == [f"3 of {count + 3} points at 1.00 s are not finite, or beyond 1000 m: left out"]
    assert stream.mapped is not None
    assert clean.mapped is not None
    np.testing.assert_array_equal(stream.mapped.label, clean.mapped.label)
    with pytest.raises(ValueError, match=r"points \(N, 3\) or more columns expected, not \(5,\)"):
        stream.update(np.zeros(5), np.eye(4), 9.0)


def test_scans_without_pose_or_stamp_are_left_out(drive: Drive) -> None:
    stream, said = ready(drive)
    for pose, time in ((None, 1.0), (np.full((4, 4), np.nan), 1.0), (np.eye(3), 1.0), (np.eye(4), np.nan)):
        assert stream.update(drive.scan(10), pose, time) is None
    assert said == ["the scan at 1.00 s has no pose: left out", "a scan without a time (nan): left out"]
    assert feed(stream, drive, range(10, 11)) == [True]


def paced(stream: Stream, drive: Drive, period: float, count: int = 20) -> list[bool]:
    """Whether a forecast follows each of the scans that come at another rate after the tenth."""
    points, found = drive.scan(9), []
    for n in range(1, count + 1):
        pose = drive.pose(9).copy()
        pose[0, 3] += 5 * n * period
        found.append(stream.update(points, pose, drive.time(9) + n * period) is not None)
    return found


def test_a_stream_without_weights_goes_along_with_another_rate(drive: Drive) -> None:
    stream, said = ready(drive)
    found = paced(stream, drive, 0.2)
    assert said == [
        "no scan for 0.20 s before 1.10 s: evidence starts anew",
        "scans come every 0.2 s instead of 0.1 s at 2.50 s: evidence starts anew",
    ]
    assert found == [False] * 11 + [True] * 9
    assert (stream.period, stream.horizons) == (0.2, 8)
    assert stream.mapper.period == 0.2


@pytest.mark.parametrize(
    ("period", "line"),
    [
        (0.05, "scans come every 0.05 s instead of 0.1 s at 1.30 s: one of 2 is taken, and evidence starts anew"),
        (
            0.15,
            "scans come every 0.15 s instead of 0.1 s at 2.10 s, and the weights were trained on 0.1 s: no "
            "forecasts meanwhile",
        ),
    ],
)
def test_weights_keep_their_rate(drive: Drive, period: float, line: str) -> None:
    """Of twice as many scans every second one is taken; at a rate that does not go with theirs there is nothing."""
    forecaster = LastFrame()
    forecaster.trained = {"data": {"period": 0.1, "resolution": 1 / 3, "cells": 32}}
    said: list[str] = []
    stream = Stream(forecaster, warn=said.append)
    feed(stream, drive, range(10))
    found = paced(stream, drive, period)
    assert said[-1] == line
    assert stream.period == 0.1
    assert found[7:] == ([False] * 8 + [True, False, True, False, True] if period == 0.05 else [False] * 13)
    after = drive.time(9) + 20 * period
    there = [stream.update(drive.scan(9), drive.pose(9), after + 0.1 * n) is not None for n in range(1, 20)]
    assert there[-5:] == [True] * 5  # the rate is what it was
    assert "0.1 s instead of" in said[-1]


def damaged(drive: Drive, folder: Path, frames: Collection[int]) -> Drive:
    """The same drive, where some scans are empty files."""
    shutil.copytree(drive.folder.parents[1], folder)  # type: ignore[attr-defined]
    for file in folder.rglob("velodyne_points/data/*.bin"):
        if int(file.stem) in frames:
            file.write_bytes(b"")
    return one_drive(folder)


def test_a_replay_goes_on_without_scans_that_cannot_be_read(drive: Drive, tmp_path: Path) -> None:
    said: list[str] = []
    spoilt = damaged(drive, tmp_path / "some", (0, 7))
    latency = Latency()
    stream = warmed(lambda: Stream.of(LastFrame(), spoilt, grid=GRID, warn=said.append), spoilt)
    steps = list(replay(stream, spoilt, latency, frames=range(14)))
    assert [step.frame for step in steps] == [*range(1, 7), *range(8, 14)]
    assert [step.frame for step in steps if step.forecast is not None] == [5, 6, 12, 13]
    assert latency.scans == 12
    assert [line.split("/")[-1] for line in said] == [
        "0000000000.bin: an empty scan; copy it again, or delete it to leave a gap in the drive; left out",
        "0000000007.bin: an empty scan; copy it again, or delete it to leave a gap in the drive; left out",
        "no scan for 0.20 s before 0.80 s: evidence starts anew",
    ]


def test_a_drive_of_which_no_scan_can_be_read_is_refused(drive: Drive, tmp_path: Path) -> None:
    spoilt = damaged(drive, tmp_path / "all", drive.frames)
    with pytest.raises(UserError, match=r"\.bin: an empty scan"):
        list(replay(ready(drive)[0], spoilt, Latency()))


def test_weights_of_another_grid_and_files_that_are_none_are_refused_before_any_scan(
    drive: Drive, tmp_path: Path
) -> None:
    trained = LastFrame()
    trained.trained = {"data": {"period": 0.1, "resolution": 0.5, "cells": 32}}
    with pytest.raises(UserError, match=r"trained on grids of 0\.5 m, this stream has 0\.333"):
        Stream.of(trained, drive, grid=GRID)
    trained.trained = {"data": {"period": 0.2, "resolution": GRID.resolution, "cells": 32}}
    with pytest.raises(UserError, match=r"trained on grids of 0\.2 s, this stream has 0\.1 s"):
        Stream.of(trained, drive, grid=GRID)
    (tmp_path / "a.ckpt").write_bytes(b"nothing")
    with pytest.raises(UserError, match=r"a\.ckpt: holds more than weights, so it is not loaded"):
        Stream.of(tmp_path / "a.ckpt", drive)
    with pytest.raises(UserError, match=r"none\.ckpt: no such checkpoint"):
        Stream.of(tmp_path / "none.ckpt", drive)
