"""Builds that are killed, interrupted or lose a worker, for real: a drive is whole or absent, the next run goes on."""

import multiprocessing
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest

from envpred.build.executors import in_processes
from envpred.cli import main
from envpred.errors import UserError
from envpred.store import Store
from tests.build import builds
from tests.remedies import remedy

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("drives")
    for number, frames in (("0001", 200), ("0002", 500), ("0003", 300)):
        builds.write_long_drive(root, number, frames)
    return root


@pytest.fixture(scope="module")
def uninterrupted(source: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    store = tmp_path_factory.mktemp("uninterrupted") / "grids"
    result = builds.run(source, store, "--workers", "2")
    assert result.returncode == 0, result.stderr
    return builds.content(store)


def check_and_finish(source: Path, store: Path, uninterrupted: dict[str, bytes]) -> None:
    """What is in the store is whole; the same command makes the rest, and nothing else remains."""
    if (store / "store.json").exists():
        builds.all_valid(store)
    result = builds.run(source, store, "--workers", "2")
    assert result.returncode == 0, result.stderr
    assert builds.content(store) == uninterrupted


def wait_until_gone(pids: list[int], seconds: float = 30) -> None:
    end = time.monotonic() + seconds
    while any(builds.runs(pid) for pid in pids):
        assert time.monotonic() < end, "workers outlive the build"
        time.sleep(0.05)


def test_kill_of_a_worker_is_one_line(source: Path, tmp_path: Path, uninterrupted: dict[str, bytes]) -> None:
    process = builds.start(source, tmp_path / "grids", "--workers", "2")
    assert builds.wait_for(lambda: builds.is_writing(tmp_path / "grids"), process)
    workers = builds.workers_of(process)
    assert len(workers) == 2
    os.kill(workers[0], signal.SIGKILL)
    _, stderr = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "Traceback" not in stderr
    assert builds.lines(stderr)[-1].startswith("envpred: a worker process was killed from outside")
    wait_until_gone(workers)
    check_and_finish(source, tmp_path / "grids", uninterrupted)


def test_workers_end_when_their_parent_is_killed(source: Path, tmp_path: Path, uninterrupted: dict[str, bytes]) -> None:
    process = builds.start(source, tmp_path / "grids", "--workers", "2")
    assert builds.wait_for(lambda: builds.is_writing(tmp_path / "grids"), process)
    workers = builds.workers_of(process)
    assert len(workers) == 2
    process.kill()
    process.wait()
    wait_until_gone(workers, 10)
    process.communicate()
    assert builds.parts(tmp_path / "grids")  # nobody was left to remove them
    check_and_finish(source, tmp_path / "grids", uninterrupted)


def interrupted(process: subprocess.Popen[str], store: Path) -> None:
    """Ctrl-C as a shell gives it, to the whole process group, and what must be true afterwards.

    All processes stand still meanwhile: the signal reaches them where they are, however late this test sends it.
    """
    os.killpg(process.pid, signal.SIGSTOP)
    workers = builds.workers_of(process)
    os.killpg(process.pid, signal.SIGINT)
    os.killpg(process.pid, signal.SIGCONT)
    _, stderr = process.communicate(timeout=60)
    assert process.returncode == 130, stderr
    assert "Traceback" not in stderr
    assert [line for line in builds.lines(stderr) if line.startswith("envpred: ")] == [
        "envpred: interrupted; run the same command again to go on"
    ]
    assert not any(builds.runs(pid) for pid in workers)
    assert builds.parts(store) == []


def test_interrupt_in_the_middle_of_a_drive(source: Path, tmp_path: Path, uninterrupted: dict[str, bytes]) -> None:
    process = builds.start(source, tmp_path / "grids", "--workers", "2")
    assert builds.wait_for(lambda: builds.is_writing(tmp_path / "grids"), process)
    interrupted(process, tmp_path / "grids")
    assert len(Store(tmp_path / "grids").drives) < 3
    check_and_finish(source, tmp_path / "grids", uninterrupted)


def test_interrupt_while_workers_start(source: Path, tmp_path: Path) -> None:
    process = builds.start(source, tmp_path / "grids", "--workers", "2")
    assert builds.wait_for(lambda: builds.workers_of(process), process)
    interrupted(process, tmp_path / "grids")


def kill_once_it_counts() -> None:
    drives = [SimpleNamespace(name="a", frames=[0])]
    for frames, _ in in_processes(builds.count_forever, drives, 1):
        if frames:
            for worker in multiprocessing.active_children():
                os.kill(cast(int, worker.pid), signal.SIGKILL)


def test_fewer_workers_where_one_was_killed(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="killed from outside") as failure:
        kill_once_it_counts()
    ((option,),) = remedy(failure.value)
    builds.write_long_drive(tmp_path / "drives", "0001", 10)
    main([*builds.command(tmp_path / "drives", tmp_path / "grids")[3:], f"{option}=1"])
    assert len(builds.all_valid(tmp_path / "grids")) == 1


@pytest.mark.parametrize("again", range(6))  # a lock taken along would be held at most every other time
def test_a_worker_killed_while_it_counts_holds_nothing_up(again: int) -> None:
    with pytest.raises(UserError, match="killed from outside"):
        kill_once_it_counts()


MEASURE = """
import resource, sys
from pathlib import Path
from types import SimpleNamespace
from typing import cast
from envpred.build.grids import build
build(Path(sys.argv[1]), Path(sys.argv[2]), workers=1)
# Its own peak is the kernel's: getrusage's starts from what the test's process had when it started this one.
own = next(line.split()[1] for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM"))
print(own, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""


def peak_memory(source: Path, store: Path) -> tuple[int, int]:
    """Largest resident memory of a build's own process and of its worker, in bytes."""
    result = subprocess.run(
        [sys.executable, "-c", MEASURE, source, store], capture_output=True, text=True, check=True, timeout=300
    )
    own, worker = result.stdout.split()
    return 1024 * int(own), 1024 * int(worker)


def test_memory_does_not_grow_with_the_drive(tmp_path: Path) -> None:
    for name, frames in (("short", 20), ("long", 720)):
        builds.write_long_drive(tmp_path / name, "0001", frames)
    short = peak_memory(tmp_path / "short", tmp_path / "short_grids")
    long = peak_memory(tmp_path / "long", tmp_path / "long_grids")
    # 700 frames more are 57 MiB of grids; what does grow is their poses, 2 to 3 kB a frame.
    assert all(b - a < 12 * 2**20 for a, b in zip(short, long, strict=True)), (short, long)
    assert max(long) < 0.5 * 2**30


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_kills_at_random_moments(source: Path, tmp_path: Path, uninterrupted: dict[str, bytes], seed: int) -> None:
    """The whole group, the parent or a worker is killed again and again, from the first import to the last rename."""
    chance = random.Random(seed)
    store = tmp_path / "grids"
    for _ in range(6):
        process = builds.start(source, store, "--workers", "2")
        if chance.random() < 0.6 and builds.wait_for(lambda: builds.parts(store), process):
            time.sleep(chance.uniform(0, 1))
        else:
            time.sleep(chance.uniform(0, 4))
        if process.poll() is None:
            workers = builds.workers_of(process)
            victims = [process.pid, *workers] if chance.random() < 0.5 else [chance.choice([process.pid, *workers])]
            for pid in victims:
                os.kill(pid, signal.SIGKILL)
            wait_until_gone(victims)
        process.communicate(timeout=120)
        if (store / "store.json").exists():
            builds.all_valid(store)
    check_and_finish(source, store, uninterrupted)


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.5, 2.0, 2.5])
def test_interrupt_at_any_moment(source: Path, tmp_path: Path, delay: float) -> None:
    process = builds.start(source, tmp_path / "grids", "--workers", "2")
    # From the moment our own code runs and loads its libraries; before, Ctrl-C is Python's own affair.
    assert builds.wait_for(lambda: "numpy" in Path(f"/proc/{process.pid}/maps").read_text(encoding="utf-8"), process)
    time.sleep(delay)
    if process.poll() is not None:
        process.communicate()
        pytest.skip("the build was faster than the interrupt")
    interrupted(process, tmp_path / "grids")
