"""One trial: what is left beside its log, what it is worth, and why it failed."""

import csv
import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from envpred.callbacks.hyperparameters import FINAL
from envpred.cli import main
from envpred.cli.arguments import FitArguments
from envpred.errors import UserError
from envpred.results.validations import VALIDATIONS, History, read_validations
from envpred.store.files import write_json
from sweeps.runs import processes
from sweeps.runs.progress import Progress, epochs_of
from sweeps.runs.trial import CONFIG, DEFAULTS, LOG, Runner, TrialEndedError, TrialFailedError, failure, fit, logged_to
from tests.build import builds
from tests.sweeps import stub


def script(text: str) -> Callable[[Path, Path], list[str]]:
    return lambda config, folder: [sys.executable, "-c", text]


def write(folder: Path, validations: list[tuple[str, float]], best: dict[str, int]) -> None:
    """A file of validations (stage, error)."""
    history = History(
        [
            {"epoch": k, "step": k, "stage": stage, "val_mse": mse, "static_mse": 1.0, "horizons": {}}
            for k, (stage, mse) in enumerate(validations)
        ],
        {name: {"monitor": "val/loss", "score": 0.0, "validation": place} for name, place in best.items()},
        ended=len(validations),
    )
    write_json(folder / VALIDATIONS, history.as_json())


def ignore(*told: object) -> None:
    pass


def test_a_trial_is_worth_its_best_checkpoints_validation(fit: FitArguments, tmp_path: Path) -> None:
    rungs: list[tuple[int, float]] = []
    config = fit.complete({"model.t1_lr": 0.01})
    value = Runner(tmp_path, stub.command).run(7, config, lambda *told: rungs.append(told), ignore)
    assert value == pytest.approx(0.02)  # the second of three validations
    assert [rung for rung, _ in rungs] == list(range(1, 11))
    # Epochs end at 33 %, 67 % and 100 %; a tenth is told with the validation that completed it.
    assert [round(100 * value) for _, value in rungs] == [3, 3, 3, 2, 2, 2, 1, 1, 1, 1]
    assert FitArguments([f"--config={tmp_path / '0007' / CONFIG}"]).base == config
    assert (tmp_path / "0007" / LOG).exists()


def test_epochs_are_those_of_all_stages_at_most_the_trainers(fit: FitArguments) -> None:
    assert epochs_of(fit.complete({"model.t1_epochs": 2, "model.t5_epochs": 5})) == 7
    assert epochs_of(fit.complete({"model.t5_epochs": 5, "trainer.max_epochs": 4})) == 4
    assert epochs_of(fit.complete({"model.t5_epochs": 5, "trainer.max_epochs": -1})) == 6


@pytest.mark.slow
def test_a_real_run_is_read_right(fit: FitArguments, tmp_path: Path) -> None:
    """Its score is the error of the best checkpoint, validated once more."""
    arguments = {"model.channels": [4], "data.samples": 2, "model.t5_lr": 0.02, "model.t5_epochs": 3}
    value = Runner(tmp_path).run(0, fit.complete(arguments, DEFAULTS), ignore, ignore)
    folder = tmp_path / "0000"
    events = EventAccumulator(str(folder)).Reload()
    assert [event.value for event in events.Scalars(FINAL)] == [pytest.approx(value)]  # what HPARAMS tells of a trial
    assert events.Tags()["images"] == []  # they take their time
    progress = Progress(folder, 4)
    assert [(found["epoch"], found["stage"]) for found in progress.validations()] == [
        (0, "t1"),
        (1, "t5"),
        (2, "t5"),
        (3, "t5"),
    ]
    assert value == progress.score()
    checkpoint = f"--ckpt_path={folder / 'checkpoints' / 'best.ckpt'}"
    again = tmp_path / "again"
    logger = ["--trainer.logger=CSVLogger", f"--trainer.logger.save_dir={again}"]
    main(["validate", f"--config={folder / CONFIG}", checkpoint, *logger, "--trainer.enable_progress_bar=false"])
    (metrics,) = again.rglob("metrics.csv")
    (row,) = csv.DictReader(metrics.open())
    assert value == pytest.approx(float(row["val/mse"]), rel=1e-5)


def test_a_score_that_is_no_number_is_refused(tmp_path: Path) -> None:
    write(tmp_path, [("t1", 0.5)], {})
    with pytest.raises(UserError, match="no best checkpoint"):
        Progress(tmp_path, 2).score()
    write(tmp_path, [("t1", 0.5), ("t5", float("nan"))], {"best_t1.ckpt": 0, "best.ckpt": 1})
    with pytest.raises(UserError, match=r"best\.ckpt is nan"):
        Progress(tmp_path, 2).score()


def test_the_score_is_of_the_final_stage(tmp_path: Path) -> None:
    """Also where an earlier stage had a lower error, or a checkpoint of another name is all there is."""
    write(tmp_path, [("t1", 0.1), ("t5", 0.4), ("t5", 0.3)], {"best_t1.ckpt": 0, "best.ckpt": 2})
    assert Progress(tmp_path, 3).score() == 0.3
    write(tmp_path, [("t1", 0.1), ("t1", 0.2)], {"best_t1.ckpt": 0})
    assert Progress(tmp_path, 2).score() == 0.1
    write(tmp_path, [("t1", 0.1), ("t5", 0.4)], {"best_t1.ckpt": 0})
    with pytest.raises(UserError, match="no best checkpoint"):
        Progress(tmp_path, 2).score()


@pytest.mark.parametrize(
    ("said", "code", "reason", "memory"),
    [
        ("x\nenvpred: no drive to train\nlater", 1, "no drive to train", False),
        ("Traceback\n  line\nValueError: broken", 1, "ValueError: broken", False),
        ("torch.OutOfMemoryError: CUDA out of memory. Tried", 1, "torch.OutOfMemoryError", True),
        ("RuntimeError: DefaultCPUAllocator: can't allocate memory: you tried", 1, "RuntimeError", True),
        ("going on", -9, "killed from outside", True),
        ("Aborted", -6, "ended by signal 6: Aborted", False),
        ("", 3, "exit code 3", False),
    ],
)
def test_reasons_of_failures(tmp_path: Path, said: str, code: int, reason: str, memory: bool) -> None:
    (tmp_path / LOG).write_text(said)
    failed = failure(tmp_path / LOG, code)
    assert isinstance(failed, TrialFailedError)
    assert str(failed).startswith(reason)
    assert failed.out_of_memory == memory


@pytest.mark.parametrize(
    ("code", "name"), [(-signal.SIGTERM, "SIGTERM"), (143, "SIGTERM"), (-signal.SIGINT, "SIGINT"), (130, "SIGINT")]
)
def test_a_run_that_a_signal_has_ended_is_told_from_one_that_failed(tmp_path: Path, code: int, name: str) -> None:
    (tmp_path / LOG).write_text("envpred: interrupted after 1 of 3 epochs")
    ended = failure(tmp_path / LOG, code)
    assert isinstance(ended, TrialEndedError)
    assert str(ended) == f"ended from outside by {name}"


def test_a_full_disk_is_no_fault_of_the_values(tmp_path: Path) -> None:
    (tmp_path / LOG).write_text("OSError: [Errno 28] No space left on device")
    assert isinstance(failure(tmp_path / LOG, 1), UserError)


def test_a_run_that_leaves_nothing_failed(fit: FitArguments, tmp_path: Path) -> None:
    with pytest.raises(TrialFailedError, match="after 0 of 3 epochs"):
        Runner(tmp_path, script("pass")).run(0, fit.base, ignore, ignore)


def test_a_run_that_did_not_reach_its_end_is_worth_nothing(fit: FitArguments, tmp_path: Path) -> None:
    """Whatever its exit code says: what tells is what `envpred fit` writes at its end."""

    def command(config: Path, folder: Path) -> list[str]:
        write(folder, [("t1", 0.1), ("t5", 0.4)], {"best.ckpt": 1})
        told = read_validations(folder)._replace(ended=None)
        write_json(folder / VALIDATIONS, told.as_json())
        return ["true"]

    with pytest.raises(TrialFailedError, match="after 2 of 3 epochs, before its end"):
        Runner(tmp_path, command).run(0, fit.base, ignore, ignore)


def test_an_ended_trial_leaves_no_process(fit: FitArguments, tmp_path: Path) -> None:
    def on_poll() -> None:
        if (tmp_path / "pid").exists():
            raise KeyboardInterrupt

    text = f"import os, time; open({str(tmp_path / 'part')!r}, 'w').write(str(os.getpid()))\n"
    text += f"os.rename({str(tmp_path / 'part')!r}, {str(tmp_path / 'pid')!r}); time.sleep(60)"
    with pytest.raises(KeyboardInterrupt):
        Runner(tmp_path, script(text)).run(0, fit.base, ignore, on_poll)
    assert not builds.runs(int((tmp_path / "pid").read_text()))


def test_a_child_dies_with_its_parent(tmp_path: Path) -> None:
    """Also by SIGKILL, where the parent cannot say anything."""
    text = "import os, sys; from sweeps.runs import processes\n"
    text += "child = processes.start(['sleep', '60'], open(os.devnull, 'wb'))\n"
    text += "print(child.pid, flush=True); child.wait()"
    read, write = os.pipe()
    with os.fdopen(write, "wb") as out:
        parent = processes.start([sys.executable, "-c", text], out)
    with os.fdopen(read) as lines:
        child = int(lines.readline())
    assert builds.runs(child)
    os.kill(parent.pid, signal.SIGKILL)
    parent.wait()
    end = time.monotonic() + 10
    while builds.runs(child):
        assert time.monotonic() < end
        time.sleep(0.02)


def test_processes_are_told_from_later_ones_of_their_number() -> None:
    us = processes.identity()
    assert not processes.is_gone(us)
    assert processes.is_gone(us | {"started": us["started"] - 1})
    assert not processes.is_gone(us | {"machine": "another", "started": 1})


def test_runs_write_where_they_are_told(tmp_path: Path) -> None:
    assert fit(tmp_path / "a" / CONFIG, tmp_path / "a")[-len(logged_to(tmp_path / "a")) :] == logged_to(tmp_path / "a")
    assert f"--trainer.logger.init_args.save_dir={tmp_path}" in logged_to(tmp_path / "a")
