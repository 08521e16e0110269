"""One run of an ablation: trained and tested by envpred, once for each configuration."""

import json
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from envpred.cli.arguments import FitArguments
from envpred.datamodules import GridDataModule
from envpred.errors import UserError
from envpred.interrupts import heed
from envpred.results.result import RESULT, read_result
from envpred.results.validations import VALIDATIONS, read_validations
from envpred.store import digest
from envpred.store.files import inside, replace_text

from ..runs import processes
from ..runs.progress import check_ended, epochs_of
from ..runs.trial import DEFAULTS, TrialFailedError, as_yaml, failure, logged_to
from .plan import Run

CONFIG, SECONDS = "run.yaml", "seconds.json"


@dataclass(frozen=True)
class Job:
    """A run with its configuration, its folder, and how many threads it may use if not all."""

    run: Run
    config: Mapping[str, Any]
    folder: Path
    threads: int | None = None

    @classmethod
    def of(cls, run: Run, store: Path, runs: Path) -> "Job":
        """The job of `run` on the grids in `store`, in a folder below `runs` that its configuration names.

        Raises:
            UserError: as `envpred fit` would refuse its options, or if it would not find its devices here.
        """
        fit = FitArguments([*run.options, f"--data.store={store}"])
        fit.check_devices()
        config = fit.complete({}, DEFAULTS)
        data = {name: value for name, value in config["data"].items() if name != "store"}
        return cls(run, config, runs / f"{run.name}-{digest({**config, 'data': data, 'store': run.store})[:8]}")

    @property
    def result(self) -> Path:
        """The result of its test."""
        return self.folder / RESULT

    def is_done(self) -> bool:
        """Whether its test has reached its end, and its result is of the grids as they are now."""
        if not (self.folder / SECONDS).is_file():  # the result is there before its pictures are
            return False
        try:
            told = read_result(self.result)["data"]
        except UserError:
            return False
        data = GridDataModule(**self.config["data"])
        data.setup("test")
        try:
            now = {name: data.content_hash("test", [name]) for name in ("evidence", *told["input_hash"])}
        except KeyError:  # of an array that is no longer there
            return False
        return bool(now == told["input_hash"] | {"evidence": told["store_hash"]})

    def do(self) -> float:
        """Train and test; what an interruption left is gone on with.  Returns the seconds that it took.

        Raises:
            TrialFailedError: with the reason.
            UserError: if the disk is full.
        """
        start = time.monotonic()
        self.folder.mkdir(parents=True, exist_ok=True)
        for of_last_time in (self.folder / SECONDS, self.result):
            of_last_time.unlink(missing_ok=True)
        replace_text(self.folder / CONFIG, as_yaml(dict(self.config)))
        checkpoints = self.folder / "checkpoints"
        if self.run.trains and read_validations(self.folder).ended is None:
            last = checkpoints / "last.ckpt"
            self._call("fit", *([f"--ckpt_path={last}"] if last.exists() else []))
            try:
                check_ended(self.folder, epochs_of(self.config))
            except UserError as error:
                raise TrialFailedError(str(error)) from None
        validations = self.folder / VALIDATIONS
        best = read_validations(self.folder).chosen() if self.run.trains else None
        self._call("test", *([f"--ckpt_path={inside(checkpoints, best.checkpoint, validations)}"] if best else []))
        if not self.result.exists():
            raise UserError(f"{self.folder}: `envpred test` left no {RESULT}; see test.log there")
        seconds = time.monotonic() - start
        replace_text(self.folder / SECONDS, json.dumps(seconds))
        return seconds

    def _call(self, command: str, *options: str) -> None:
        given = ["--config", str(self.folder / CONFIG), *logged_to(self.folder), *options]
        log = self.folder / f"{command}.log"
        with log.open("wb") as out:
            process = processes.start([sys.executable, "-m", "envpred", command, *given], out, threads=self.threads)
            try:
                code = processes.wait(process)
            finally:
                processes.stop(process)
        if code:
            heed()  # of what has ended the run, too
            raise failure(log, code)
