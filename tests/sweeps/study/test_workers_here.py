"""`envpred tune --workers 2`: two processes share a study, and end with whoever started them."""

import os
import signal
import subprocess
import time
from pathlib import Path

import pytest
from optuna.trial import FrozenTrial, TrialState

from sweeps.study.best import BEST
from sweeps.study.retry import LOSSES, RETRY_OF, WORKER
from tests.build import builds
from tests.sweeps.conftest import tuning
from tests.sweeps.study.test_workers import NAME, start, trials_of

TRIALS = 6


def running(folder: Path) -> list[FrozenTrial]:
    """Trials that run, once all their values are drawn."""
    time.sleep(0.1)  # a look reads the whole journal
    try:
        trials = trials_of(folder) if folder.exists() else []
    except KeyError:
        return []
    return [t for t in trials if t.state == TrialState.RUNNING and {WORKER, "arguments"} <= t.user_attrs.keys()]


def family(pid: int) -> list[int]:
    """A process's children and theirs."""
    children = []
    for thread in Path(f"/proc/{pid}/task").iterdir():
        children += [int(child) for child in (thread / "children").read_text().split()]
    return [*children, *(grandchild for child in children for grandchild in family(child))]


def ended(command: subprocess.Popen[str], folder: Path, number: signal.Signals) -> tuple[list[FrozenTrial], str]:
    """End the command by a signal once each worker runs a trial; gives these and what the command said."""
    try:
        assert builds.wait_for(lambda: len(running(folder)) == 2 and len(family(command.pid)) == 4, command)
        trials, processes = running(folder), family(command.pid)
        assert {trial.user_attrs[WORKER]["pid"] for trial in trials} <= set(processes)
        os.kill(command.pid, number)
        said, _ = command.communicate(timeout=60)
    finally:
        command.kill()
    end = time.monotonic() + 10
    while any(map(builds.runs, processes)) and time.monotonic() < end:
        time.sleep(0.05)
    assert [pid for pid in processes if builds.runs(pid)] == []
    return trials, said


@pytest.mark.slow
def test_workers_share_a_study_and_end_with_their_parent(store: Path, space_file: Path, tmp_path: Path) -> None:
    args = tuning(store, space_file, tmp_path, f"--trials={TRIALS}", "--pruner=none", "--workers=2")
    folder = tmp_path / NAME
    command = start("tests.sweeps.stub", args, STUB_SECONDS="60")
    interrupted, said = ended(command, folder, signal.SIGINT)
    assert command.returncode == 130
    assert said.splitlines()[-1] == "envpred tune: interrupted; run the same command again to go on"
    assert said.count("envpred tune: ") == 1
    assert "Traceback" not in said
    command = start("tests.sweeps.stub", args, STUB_SECONDS="60")
    killed, _ = ended(command, folder, signal.SIGKILL)
    command = start("tests.sweeps.stub", args, STUB_SECONDS="1")
    said, _ = command.communicate(timeout=300)
    assert command.returncode == 0, said
    assert said.count(f"best of {TRIALS}: {folder / BEST}") == 1
    trials = trials_of(folder)
    states = [trial.state for trial in trials]
    assert (states.count(TrialState.COMPLETE), states.count(TrialState.FAIL), len(states)) == (TRIALS, 4, TRIALS + 4)
    done = [trial for trial in trials if trial.state == TrialState.COMPLETE]
    assert len({trial.user_attrs[WORKER]["pid"] for trial in done}) == 2
    # What an interruption ended is no loss of a worker; the retries of both are what the last command began with.
    assert sorted(t.user_attrs[RETRY_OF] for t in killed) == sorted(t.number for t in interrupted)  # in any order
    again = {trial.user_attrs[RETRY_OF]: trial.user_attrs[LOSSES] for trial in trials if RETRY_OF in trial.user_attrs}
    assert again == {t.number: 0 for t in interrupted} | {t.number: 1 for t in killed}
