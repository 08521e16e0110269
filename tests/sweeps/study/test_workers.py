"""Two workers on one study, one of them killed: no trial is lost, none counts twice, the study ends as asked."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import optuna
import pytest
from optuna.trial import FrozenTrial, TrialState

from sweeps.study.best import BEST
from sweeps.study.retry import RETRY_OF, WORKER
from sweeps.study.storage import open_storage
from tests.build import builds
from tests.sweeps.conftest import REPOSITORY, tuning

NAME = "prednet_dst_static"
TRIALS = 12


def start(module: str, args: list[str], **environment: str) -> subprocess.Popen[str]:
    """A worker in a process group of its own, as a shell starts it."""
    return subprocess.Popen(
        [sys.executable, "-m", module, *args],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        process_group=0,
        cwd=REPOSITORY,
        env=os.environ | environment,
    )


def trials_of(folder: Path, url: str | None = None) -> list[FrozenTrial]:
    return optuna.load_study(study_name=NAME, storage=open_storage(folder, url)).trials


def running_of(folder: Path, url: str | None, pid: int) -> FrozenTrial | None:
    """The trial that the worker runs, once all its values are drawn."""
    time.sleep(0.1)  # a look reads the whole journal
    try:
        trials = trials_of(folder, url) if folder.exists() or url else []
    except KeyError:
        return None
    for trial in trials:
        if trial.state == TrialState.RUNNING and trial.user_attrs.get(WORKER, {}).get("pid") == pid:
            return trial if "arguments" in trial.user_attrs else None
    return None


def check_killed_study(folder: Path, args: list[str], url: str | None, module: str, **environment: str) -> None:
    """Run a study with two workers, kill one in mid-trial, and look at what is left."""
    workers = [start(module, args, **environment) for _ in range(2)]
    try:
        found: list[FrozenTrial] = []

        def is_running() -> bool:
            found[:] = [trial for trial in [running_of(folder, url, workers[0].pid)] if trial is not None]
            return bool(found)

        assert builds.wait_for(is_running, workers[0])
        children = Path(f"/proc/{workers[0].pid}/task/{workers[0].pid}/children").read_text(encoding="utf-8").split()
        os.kill(workers[0].pid, signal.SIGKILL)
        workers[0].communicate()
        said, _ = workers[1].communicate(timeout=300)
        assert workers[1].returncode == 0, said
        assert not any(builds.runs(int(child)) for child in children)
    finally:
        for worker in workers:
            if worker.poll() is None:
                os.killpg(worker.pid, signal.SIGKILL)
    trials = trials_of(folder, url)
    killed = trials[found[0].number]
    assert killed.state == TrialState.FAIL
    (retry,) = [trial for trial in trials if RETRY_OF in trial.user_attrs]
    assert (retry.user_attrs[RETRY_OF], retry.params, retry.state) == (
        killed.number,
        killed.params,
        TrialState.COMPLETE,
    )
    states = [trial.state for trial in trials if trial.state != TrialState.WAITING]
    assert states.count(TrialState.COMPLETE) == TRIALS
    assert states.count(TrialState.FAIL) == 1
    assert len(states) == TRIALS + 1
    assert killed.user_attrs[WORKER]["pid"] == workers[0].pid
    assert retry.user_attrs[WORKER]["pid"] == workers[1].pid
    assert (folder / BEST).exists()


@pytest.mark.slow
def test_a_worker_is_killed_in_mid_trial(store: Path, space_file: Path, tmp_path: Path) -> None:
    args = tuning(store, space_file, tmp_path, f"--trials={TRIALS}", "--pruner=none")
    check_killed_study(tmp_path / NAME, args, None, "tests.sweeps.stub", STUB_SECONDS="1")


@pytest.mark.slow
def test_a_worker_is_killed_while_it_trains(store: Path, space_file: Path, tmp_path: Path) -> None:
    args = tuning(store, space_file, tmp_path, f"--trials={TRIALS}", "--pruner=none")
    check_killed_study(tmp_path / NAME, args, None, "sweeps.tune")


@pytest.mark.slow
def test_ctrl_c_is_one_line_and_the_same_command_goes_on(store: Path, space_file: Path, tmp_path: Path) -> None:
    args = tuning(store, space_file, tmp_path, "--trials=1", "--pruner=none")
    worker = start("tests.sweeps.stub", args, STUB_SECONDS="60")
    folder = tmp_path / NAME
    assert builds.wait_for(lambda: running_of(folder, None, worker.pid), worker)
    time.sleep(0.3)
    os.killpg(worker.pid, signal.SIGINT)
    said, _ = worker.communicate(timeout=60)
    assert worker.returncode == 130
    assert said.splitlines()[-1] == "envpred tune: interrupted; run the same command again to go on"
    assert "Traceback" not in said
    worker = start("tests.sweeps.stub", args)
    said, _ = worker.communicate(timeout=120)
    assert worker.returncode == 0, said
    first, second = trials_of(folder)
    assert (first.state, second.state) == (TrialState.FAIL, TrialState.COMPLETE)
    assert first.params == second.params
