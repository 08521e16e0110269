"""Trainings and tests that a signal ends: an exit code of their own, and one line that says how to go on."""

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from filelock import FileLock

from envpred.callbacks import Pictures
from envpred.cli import main
from envpred.models import PredNetForecaster
from envpred.results.validations import read_validations
from envpred.store.parts import LOCK
from tests.store.stores import write_store

RUN = Path("runs/fit/prednet/dst_static/version_0")
QUIET = ["--trainer.accelerator=cpu", "--trainer.enable_progress_bar=false", "--trainer.enable_model_summary=false"]
SMALL = ["--model=PredNetForecaster", "--model.channels=[4]", "--model.t1_lr=0.002", "--data.store=grids"]
CODES = {signal.SIGTERM: 143, signal.SIGINT: 130}


@pytest.fixture(autouse=True)
def inside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Pictures, "on_validation_end", lambda *_: None)  # drawing takes longer than all else
    write_store(tmp_path / "grids", {name: list(range(40)) for name in "abc"})


def ended(args: list[str], number: signal.Signals, when: Callable[[], bool]) -> int:
    """Run a command in this process, send it a signal when something holds, and return its exit code."""

    def send() -> None:
        end = time.monotonic() + 60
        while not when() and time.monotonic() < end:
            time.sleep(0.01)
        os.kill(os.getpid(), number)

    sender = threading.Thread(target=send)
    sender.start()
    with pytest.raises(SystemExit) as stop:
        main(args)
    sender.join()
    return int(stop.value.code or 0)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_training_that_is_ended_says_so_and_goes_on(
    number: signal.Signals, capsys: pytest.CaptureFixture[str]
) -> None:
    fit = ["fit", *SMALL, *QUIET, "--data.samples=2", "--model.t1_epochs=500", "--model.t5_epochs=0"]
    before = signal.getsignal(number)
    assert ended(fit, number, lambda: len(read_validations(RUN).validations) > 2) == CODES[number]
    assert signal.getsignal(number) == before
    (line,) = [line for line in capsys.readouterr().err.splitlines() if "interrupt" in line.lower()]
    done = int(torch.load(RUN / "checkpoints/last.ckpt", weights_only=True)["epoch"]) + 1
    assert line == (
        f"envpred: interrupted after {done} of 500 epochs; run the same command again with "
        f"--ckpt_path {RUN}/checkpoints/last.ckpt to go on"
    )
    assert read_validations(RUN).ended is None
    main([*fit, *line.split("with ")[1].removesuffix(" to go on").split(), f"--trainer.max_epochs={done + 1}"])
    assert read_validations(RUN).ended == done + 1
    main([*fit, "--ckpt_path=last", f"--trainer.max_epochs={done + 1}"])  # nothing is left to train
    assert read_validations(RUN).ended == done + 1


def test_ctrl_c_that_a_library_swallows_ends_a_training_too(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    step = PredNetForecaster.training_step

    def swallowing(self: PredNetForecaster, *batch: object) -> object:
        try:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(1)
        except KeyboardInterrupt:
            pass
        return step(self, *batch)  # type: ignore[arg-type]

    monkeypatch.setattr(PredNetForecaster, "training_step", swallowing)
    for _ in range(2):  # as it says: the same command again
        with pytest.raises(SystemExit) as stop:
            main(["fit", *SMALL, *QUIET, "--data.samples=8", "--data.batch_size=1", "--model.t1_epochs=2", "--name=a"])
        assert stop.value.code == 130
        line = "after 0 of 102 epochs, before the first checkpoint; run the same command again"
        assert line in capsys.readouterr().err
        assert list(RUN.parent.iterdir()) == []


def test_a_training_that_was_killed_at_its_beginning_leaves_nothing_in_the_way(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    fit = ["fit", *SMALL, *QUIET, "--data.samples=2", "--model.t1_epochs=1", "--model.t5_epochs=0"]

    def killed(*more: str) -> None:
        with monkeypatch.context() as step:
            step.setattr(PredNetForecaster, "training_step", lambda *_: os.kill(os.getpid(), signal.SIGKILL))
            process = multiprocessing.get_context("fork").Process(target=main, args=([*fit, *more],))
            process.start()
            process.join()
        assert process.exitcode == -signal.SIGKILL

    killed()
    killed("--name=mine")
    assert {run.name for run in RUN.parent.iterdir()} == {"mine"}  # the next one has removed the first
    (RUN.parent / "notes").mkdir()
    (RUN.parent / "notes" / "thesis.txt").touch()
    main([*fit, "--name=mine"])
    assert {run.name for run in RUN.parent.iterdir()} == {"mine", "notes"}
    assert (RUN.parent / "mine" / "checkpoints" / "last.ckpt").is_file()
    assert not list(RUN.parent.rglob(LOCK))
    with FileLock(RUN.parent / "mine" / LOCK), pytest.raises(SystemExit):
        main([*fit, "--name=mine", "--ckpt_path=last", "--trainer.max_epochs=2"])
    assert "mine: another process trains into it; wait for it" in capsys.readouterr().err


def test_a_test_that_is_ended_is_no_success(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(PredNetForecaster, "test_step", lambda *_: os.kill(os.getpid(), signal.SIGTERM))
    with pytest.raises(SystemExit) as stop:
        main(["test", *SMALL, *QUIET, "--ckpt_path=none", "--data.batch_size=1"])
    assert stop.value.code == 143
    assert "interrupted; run the same command again" in capsys.readouterr().err
