"""Ctrl-C while a sweep loads, where libraries make something else of it: one exit code, and one line."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import NoReturn

import pytest

from envpred.cli.arguments import FitArguments
from envpred.interrupts import MESSAGE, noted
from sweeps import ablation, tune
from sweeps.runs.trial import Runner
from sweeps.study.storage import TidyLock
from sweeps.table.job import Job
from sweeps.table.plan import Run
from tests.sweeps.conftest import SMALL, tuning

# As a C extension does that meets a KeyboardInterrupt while it loads.
LOADING = """
import os, runpy, signal, sys, time

class Optuna:
    def find_spec(self, name, *_):
        if name == "optuna":
            try:
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(1)
            except KeyboardInterrupt:
                raise ImportError("numpy.core.multiarray failed to import") from None

sys.meta_path.insert(0, Optuna())
sys.argv[0] = "-m"  # as it is while `python -m` finds a module
runpy.run_module("sweeps.tune", run_name="__main__", alter_sys=True)
"""


def swallow(*_: object) -> NoReturn:
    try:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(1)
    except KeyboardInterrupt:
        raise ImportError("numpy.core.multiarray failed to import") from None
    raise AssertionError


def test_while_the_module_loads() -> None:
    run = subprocess.run([sys.executable, "-c", LOADING], capture_output=True, text=True, check=False)
    assert (run.returncode, run.stderr) == (130, f"{MESSAGE}\n")


def test_while_a_command_reads_what_it_is_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(tune, "read_space", swallow)
    monkeypatch.setattr(ablation, "make_plan", swallow)
    out = [f"--store={tmp_path}", f"--out={tmp_path}", f"--config={SMALL}"]
    for main, args in ((tune.main, ["--variant=dst_static", "--space=prednet"]), (ablation.main, [])):
        process = os.fork()  # it is ended where it stands
        if process == 0:
            try:
                main([*out, *args])
            finally:
                os._exit(1)
        assert os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]) == 130
        assert capfd.readouterr().err == f"{MESSAGE}\n"


def test_while_runs_go_on(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Then what runs is ended in order, whatever becomes of the exception."""
    monkeypatch.setattr(ablation, "execute", swallow)
    handler = signal.getsignal(signal.SIGINT)
    with pytest.raises(SystemExit) as stop:
        ablation.main([f"--store={store}", f"--out={tmp_path}", f"--config={SMALL}", "--variants=[]", "--switches=[]"])
    assert stop.value.code == 130
    assert capsys.readouterr().err == "envpred ablate: interrupted; run the same command again to go on\n"
    assert signal.getsignal(signal.SIGINT) == handler


@pytest.mark.usefixtures("stubbed")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_while_the_journal_is_locked(
    store: Path,
    space_file: Path,
    tmp_path: Path,
    number: signal.Signals,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A lock that an exception left behind would be waited for, by this very worker first."""
    acquire, release = TidyLock.acquire, TidyLock.release
    struck: list[int] = []
    held: list[TidyLock] = []
    left_behind: list[TidyLock] = []

    def strike(lock: TidyLock) -> bool:
        left_behind.extend(held)
        got = acquire(lock)
        held.append(lock)
        if any(tmp_path.rglob("trial.yaml")) and not struck:
            struck.append(number)
            os.kill(os.getpid(), number)
        return got

    def let_go(lock: TidyLock) -> None:
        held.clear()
        release(lock)

    monkeypatch.setattr(TidyLock, "acquire", strike)
    monkeypatch.setattr(TidyLock, "release", let_go)
    monkeypatch.setenv("STUB_SECONDS", "30")
    with pytest.raises(SystemExit) as stop:
        tune.main(tuning(store, space_file, tmp_path, "--name=a", "--grace=1"))
    assert (struck, stop.value.code) == ([number], 128 + number)
    assert "interrupted; run the same command again" in capsys.readouterr().err
    assert not left_behind


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_while_a_child_is_started(fit: FitArguments, tmp_path: Path) -> None:
    """Python calls what is registered for that, and only prints what it raises."""
    armed = [True, True]

    def strike() -> None:
        if armed:
            armed.pop()
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(1)

    os.register_at_fork(after_in_parent=strike)
    with pytest.raises(KeyboardInterrupt), noted():
        Runner(tmp_path, lambda *_: ["sleep", "60"]).run(0, fit.base, lambda *_: None, lambda: None)
    assert armed == [True]
    with pytest.raises(KeyboardInterrupt), noted():
        Job(Run("a", (), "main", ()), {}, tmp_path)._call("fit")
    assert armed == []
