"""One trial: a run of `envpred fit` in a process of its own, with its configuration and its log beside it."""

import re
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from envpred.cli.surroundings import is_full
from envpred.errors import UserError
from envpred.interrupts import SIGNALS, heed

from . import processes
from .progress import Progress, epochs_of

CONFIG, LOG = "trial.yaml", "fit.log"
DEFAULTS = {"pictures.every_n_epochs": 0}  # of `envpred fit` in a sweep: they take a quarter of a small run's time
MEMORY = re.compile(r"out of memory|OutOfMemory|MemoryError|can't allocate memory|bad_alloc", re.IGNORECASE)
DISK = re.compile(r"No space left on device|Disk quota exceeded")

Command = Callable[[Path, Path], list[str]]  # the configuration and the run's folder -> what is run


class TrialFailedError(Exception):
    """A trial that its own values made fail; the message is the reason."""

    def __init__(self, reason: str, out_of_memory: bool = False) -> None:
        super().__init__(reason)
        self.out_of_memory = out_of_memory


class TrialEndedError(TrialFailedError):
    """A trial that a signal from outside has ended, whatever its values are."""


def fit(config: Path, folder: Path) -> list[str]:
    """The command of a run: `envpred fit` of a configuration, logging to `folder`."""
    return [sys.executable, "-m", "envpred", "fit", "--config", str(config), *logged_to(folder)]


def logged_to(folder: Path) -> list[str]:
    """Options by which a run of envpred writes into `folder`."""
    logger = {"save_dir": str(folder.parent), "name": folder.name, "version": "", "default_hp_metric": "false"}
    options = [f"--trainer.logger.init_args.{name}={value}" for name, value in logger.items()]
    bar = "--trainer.enable_progress_bar=false"
    return ["--trainer.logger=lightning.pytorch.loggers.TensorBoardLogger", *options, bar]


@dataclass(frozen=True)
class Runner:
    """Runs trials in folders below `folder`.

    Args:
        folder: of all trials.
        command: what is run for a configuration.
    """

    folder: Path
    command: Command = fit

    def run(
        self, number: int, config: dict[str, Any], on_rung: Callable[[int, float], None], on_poll: Callable[[], None]
    ) -> float:
        """Run trial `number` with a complete configuration; returns its validation error.

        Args:
            number: of the trial.
            config: as `envpred fit` takes it.
            on_rung: told about each tenth of the schedule with the validation error there; may raise to end the trial.
            on_poll: called several times a second; may raise to end the trial.

        Raises:
            TrialFailedError: with the reason.
            TrialEndedError: where its values are not to blame.
            UserError: if the disk is full.
        """
        folder = self.folder / f"{number:04d}"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / CONFIG).write_text(as_yaml(config), encoding="utf-8")
        progress = Progress(folder, epochs_of(config))
        with (folder / LOG).open("wb") as log:
            process = processes.start(self.command(folder / CONFIG, folder), log)
            try:
                code = None
                while code is None:
                    on_poll()
                    heed()
                    time.sleep(processes.POLL_SECONDS)
                    code = process.poll()
                    for rung, value in progress.new_rungs().items():
                        on_rung(rung, value)
            finally:
                processes.stop(process)
        if code != 0:
            heed()  # of what has ended this process's trial, too
            raise failure(folder / LOG, code)
        try:
            return progress.score()
        except UserError as error:
            raise TrialFailedError(str(error)) from None


def failure(log: Path, code: int) -> Exception:
    """Why a run ended with `code`, from the end of its log: its own line, else the last one of a traceback."""
    lines = [line for line in log.read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()]
    told = next((line.removeprefix("envpred: ") for line in reversed(lines) if line.startswith("envpred: ")), None)
    reason = told or (lines[-1].strip() if lines else f"exit code {code}")
    text = "\n".join(lines[-50:])
    if DISK.search(text) or is_full(log.parent):  # then the log may lack its end, too
        return UserError(f"{log.parent}: the disk is full; make room, then run the same command again to go on")
    if code == -9:
        return TrialFailedError("killed from outside (out of memory?)", out_of_memory=True)
    ended = next((number for number in SIGNALS if code in (-number, 128 + number)), None)
    if ended is not None:
        return TrialEndedError(f"ended from outside by {ended.name}")
    if code < 0:
        return TrialFailedError(f"ended by signal {-code}: {reason}")
    return TrialFailedError(reason, out_of_memory=MEMORY.search(text) is not None)


def as_yaml(config: dict[str, Any]) -> str:
    """A configuration as a file that `envpred fit --config` takes."""
    return str(yaml.safe_dump(config, sort_keys=False, default_flow_style=None, width=120))
