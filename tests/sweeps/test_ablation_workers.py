"""Runs of an ablation at once: side by side, and none of them outlives the end of another."""

import os
import subprocess
import threading
from pathlib import Path

import pytest

from envpred.errors import UserError
from sweeps.runs import processes
from sweeps.runs.trial import TrialFailedError
from sweeps.table.execute import outcomes
from sweeps.table.job import Job
from sweeps.table.plan import Run


def jobs(folder: Path, *names: str) -> list[Job]:
    return [Job(Run(name, (), "main", ()), {}, folder / name) for name in names]


def test_two_at_once_with_their_share_of_the_cores(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    meeting = threading.Barrier(2, timeout=30)
    threads = []

    def do(job: Job) -> float:
        meeting.wait()  # broken, and the test fails, if one waits for the other to end
        threads.append(job.threads)
        if job.run.name == "b":
            raise TrialFailedError("diverged")
        return 0.0

    monkeypatch.setattr(Job, "do", do)
    found = {job.run.name: failure for job, failure in outcomes(jobs(tmp_path, *"abcd"), 2)}
    assert sorted(found) == ["a", "b", "c", "d"]
    assert str(found["b"]) == "diverged"
    assert [name for name, failure in found.items() if failure is None] == [n for n in found if n != "b"]
    assert threads == [processes.threads_each(2)] * 4


def test_a_test_that_leaves_no_result_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Job, "_call", lambda *_: None)
    job = Job(Run("a", (), "main", (), trains=False), {}, tmp_path / "a")
    with pytest.raises(UserError, match=rf"{job.folder}: `envpred test` left no result\.json; see test\.log there"):
        job.do()


def test_children_are_told_how_many_threads_to_use(tmp_path: Path) -> None:
    with (tmp_path / "log").open("wb") as log:
        assert processes.start(["sh", "-c", "echo $OMP_NUM_THREADS"], log, threads=3).wait() == 0
    assert (tmp_path / "log").read_text() == "3\n"


def test_a_full_disk_ends_the_others_and_starts_no_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    children: list[subprocess.Popen[bytes]] = []
    running = threading.Event()
    started = []

    def do(job: Job) -> float:
        started.append(job.run.name)
        if job.run.name == "full":
            assert running.wait(30)
            raise UserError("the disk is full")
        with open(os.devnull, "wb") as log:
            children.append(processes.start(["sleep", "60"], log))
            running.set()
            code = children[-1].wait()
        raise TrialFailedError(f"ended by {code}")

    monkeypatch.setattr(Job, "do", do)
    with pytest.raises(UserError, match="the disk is full"):
        list(outcomes(jobs(tmp_path, "long", "full", *"abcdef"), 2))
    assert all(child.poll() is not None for child in children)
    assert len(started) < 5  # one more may have begun before the end was known
