"""What a user may get wrong of `envpred simulate`, and disks: one clear line, and nothing half done."""

import errno
import os
import shutil
from collections import namedtuple
from pathlib import Path

import numpy as np
import pytest

from envpred.errors import UserError
from envpred.simulate import run
from envpred.simulate.lidar import HDL64E
from envpred.simulate.run import simulate
from envpred.simulate.traffic import KINDS, Recording


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"drives": 0}, "--drives 0"),
        ({"drives": 10_000}, "9999"),
        ({"frames": 0}, "--frames 0"),
        ({"seed": -1}, "--seed -1"),
        ({"workers": 0}, "--workers 0"),
        ({"beams": 48}, "--beams 48: give one of 16, 32, 64, 128"),
        ({"recording": Path("nowhere.npz")}, r"nowhere\.npz"),
        ({"frames": 2000}, "GB"),
    ],
)
def test_a_wrong_argument_is_one_clear_line_and_leaves_nothing(
    tmp_path: Path, change: dict[str, object], words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if "GB" in words:
        usage = namedtuple("usage", "total used free")
        monkeypatch.setattr(shutil, "disk_usage", lambda _: usage(10**9, 0, 10**8))
    arguments = {"drives": 1, "frames": 2, "seed": 0, "workers": 1} | change
    with pytest.raises(UserError, match=words):
        simulate(tmp_path / "out", **arguments)  # type: ignore[arg-type]
    assert not (tmp_path / "out").exists()


def test_a_folder_that_holds_something_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("years of work")
    with pytest.raises(UserError, match="holds something"):
        simulate(tmp_path, drives=1, frames=2)
    with pytest.raises(UserError, match="holds something"):
        simulate(tmp_path / "thesis.txt", drives=1, frames=2)
    assert os.listdir(tmp_path) == ["thesis.txt"]


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match=r"file/out: cannot be written \(Not a directory\); give another folder"):
        simulate(tmp_path / "file" / "out", drives=1, frames=2, workers=1)


def test_a_drive_longer_than_the_recording_names_the_longest(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"no car of the recording .*longest: 2[0-9]{3} frames"):
        simulate(tmp_path / "out", drives=1, frames=5000, workers=1)
    assert not (tmp_path / "out").exists()


def test_long_drives_are_made_where_a_car_drives_that_long() -> None:
    recording = Recording.load(run.builtin_recording())
    longest = [network.longest(recording.interval) for network in recording.networks]
    towns = list(range(len(longest)))
    assert run._able_towns(recording, towns, 2) == towns
    assert run._able_towns(recording, towns, max(longest)) == [int(np.argmax(longest))]
    assert run._able_towns(recording, [1], 2) == [1]
    cars = [m for m in recording.motions(0) if KINDS[m.kind] == "car"]
    assert max(len(m.speed) for m in cars) == longest[0]


def test_a_full_disk_leaves_no_half_drive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []

    def full(*arguments: object) -> object:
        calls.append(arguments)
        if len(calls) == 3:
            raise OSError(errno.ENOSPC, "No space left on device")
        return original(*arguments)  # type: ignore[arg-type]

    original = HDL64E.scan
    monkeypatch.setattr(HDL64E, "scan", full)
    source = run.builtin_recording()
    with pytest.raises(UserError, match="no space left"):
        run._drive(tmp_path, 1, 5, 0, source, {0: 1.0})
    assert os.listdir(tmp_path) == []
