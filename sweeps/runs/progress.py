"""What a run of `envpred fit` tells while it goes on: its validations, from the file that it replaces after each."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from envpred.errors import UserError
from envpred.gate.runs import Validation
from envpred.results.validations import read_validations

RUNGS = 10


def epochs_of(config: Mapping[str, Any]) -> int:
    """Epochs that a complete configuration trains: those of its model's stages, at most the trainer's."""
    arguments = config["model"].get("init_args") or {}
    stages = sum(int(value) for name, value in arguments.items() if name.endswith("epochs"))
    limit = config["trainer"].get("max_epochs")
    return stages if limit in (None, -1) else min(stages, int(limit))


@dataclass
class Progress:
    """The validations of the run in `folder`, which takes `epochs`.

    Schedules differ from trial to trial, so a validation is placed by the tenths of its own schedule that are behind
    it: there trials are compared.
    """

    folder: Path
    epochs: int
    told: int = field(default=0)

    def new_rungs(self) -> dict[int, float]:
        """Tenths of the schedule (1 ... 10) completed since the last call, each with the newest error by then."""
        rungs: dict[int, float] = {}
        for validation in self.validations():
            reached = min(RUNGS, math.floor(RUNGS * (validation["epoch"] + 1) / max(self.epochs, 1) + 1e-9))
            rungs |= dict.fromkeys(range(self.told + 1, reached + 1), validation["val_mse"])
            self.told = max(self.told, reached)
        return rungs

    def validations(self) -> list[Validation]:
        """Every validation so far."""
        return read_validations(self.folder).validations

    def score(self) -> float:
        """The mean squared error, over windows and horizons, of the best checkpoint of the final stage.

        Raises:
            UserError: if there is none, it is not finite, or the run has not reached its end.
        """
        check_ended(self.folder, self.epochs)
        chosen = read_validations(self.folder).chosen()
        if chosen is None:
            raise UserError("the run left no best checkpoint or no validation")
        value = chosen.validation["val_mse"]
        if not math.isfinite(value):
            raise UserError(f"the validation error of {chosen.checkpoint} is {value}")
        return value


def check_ended(folder: Path, epochs: int) -> None:
    """Refuse the run in `folder`, which takes `epochs`, if it has not reached its end, whatever its exit code was.

    Raises:
        UserError: with the epochs that it has done.
    """
    found = read_validations(folder)
    if found.ended is None:
        done = found.validations[-1]["epoch"] + 1 if found.validations else 0
        raise UserError(f"the run ended after {done} of {epochs} epochs, before its end")
