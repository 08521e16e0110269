"""Simulations that are killed, interrupted or started twice, for real: drives are whole or not there, and go on."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from filelock import FileLock

from envpred.errors import UserError
from envpred.simulate.run import LOCK, simulate
from envpred.simulate.writer import DATE, drive_name
from tests.build import builds

pytestmark = pytest.mark.slow

DRIVES, FRAMES = 2, 8


def start(out: Path) -> subprocess.Popen[str]:
    command = ["simulate", str(out), "--drives", str(DRIVES), "--frames", str(FRAMES), "--workers", "1"]
    return subprocess.Popen(
        [sys.executable, "-m", "envpred", *command],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        process_group=0,
    )


def begun(out: Path) -> list[Path]:
    return list(out.glob(f"{DATE}/.*.unfinished/velodyne_points/data/*.bin"))


def content(out: Path) -> dict[str, bytes]:
    return {name: data for name, data in builds.content(out).items() if name != LOCK}


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    out = tmp_path_factory.mktemp("uninterrupted")
    simulate(out, drives=DRIVES, frames=FRAMES, workers=1)
    return content(out)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_the_same_command_goes_on(tmp_path: Path, number: signal.Signals, uninterrupted: dict[str, bytes]) -> None:
    out = tmp_path / "drives"
    process = start(out)
    assert builds.wait_for(lambda: begun(out), process)
    workers = builds.workers_of(process)
    if number == signal.SIGKILL:
        process.kill()
    else:
        os.killpg(process.pid, number)
    _, stderr = process.communicate(timeout=60)
    end = time.monotonic() + 30
    while any(builds.runs(pid) for pid in workers):
        assert time.monotonic() < end, "workers outlive the simulation"
        time.sleep(0.02)
    if number == signal.SIGINT:
        assert process.returncode == 130, stderr
        assert not begun(out)
    assert not (out / DATE / drive_name(2)).exists()
    simulate(out, drives=DRIVES, frames=FRAMES, workers=1)
    assert content(out) == uninterrupted


def test_two_at_once_are_refused(tmp_path: Path) -> None:
    (tmp_path / DATE).mkdir()
    with FileLock(tmp_path / LOCK), pytest.raises(UserError, match="holds something already"):
        simulate(tmp_path, drives=1, frames=FRAMES)
    (tmp_path / DATE).rmdir()
    with FileLock(tmp_path / LOCK), pytest.raises(UserError, match="another process simulates into it; wait for it"):
        simulate(tmp_path, drives=1, frames=FRAMES)


def test_drives_that_are_there_are_kept(tmp_path: Path) -> None:
    simulate(tmp_path, drives=1, frames=FRAMES, workers=1)
    first = tmp_path / DATE / drive_name(1)
    times = {file: file.stat().st_mtime_ns for file in first.rglob("*")}
    left = tmp_path / DATE / f".{drive_name(2)}.unfinished"
    left.mkdir()
    simulate(tmp_path, drives=DRIVES, frames=FRAMES, workers=1)
    assert {file: file.stat().st_mtime_ns for file in first.rglob("*")} == times
    assert (tmp_path / DATE / drive_name(2) / "tracklet_labels.xml").exists()
    assert not left.exists()
    with pytest.raises(UserError, match=f"simulated otherwise .frames {FRAMES} there, 5 asked, seed 0 there, 1 asked"):
        simulate(tmp_path, drives=DRIVES, frames=5, seed=1, workers=1)
