"""What a run of `envpred fit` tells while it goes on: its validations, read from its TensorBoard events."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tensorboard.backend.event_processing.event_accumulator import IMAGES, SCALARS, EventAccumulator

from envpred.errors import UserError
from envpred.models.checkpoints import read_checkpoint

METRIC = "val/mse"  # mean over the horizons
BEST = ("best.ckpt", "best_t1.ckpt")  # of the final stage, if there is one, else of the only one
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
    events: EventAccumulator | None = None
    told: int = field(default=0)

    def new_rungs(self) -> dict[int, float]:
        """Tenths of the schedule (1 ... 10) completed since the last call, each with the newest error by then."""
        values = self.validations()
        rungs: dict[int, float] = {}
        for epoch, _, value in values:
            reached = min(RUNGS, math.floor(RUNGS * (epoch + 1) / max(self.epochs, 1) + 1e-9))
            rungs |= dict.fromkeys(range(self.told + 1, reached + 1), value)
            self.told = max(self.told, reached)
        return rungs

    def validations(self) -> list[tuple[int, int, float]]:
        """Epoch, training step and error of every validation so far."""
        if self.events is None:
            if not any(self.folder.glob("events.out.tfevents.*")):
                return []
            self.events = EventAccumulator(str(self.folder), size_guidance={SCALARS: 0, IMAGES: 1})
        self.events.Reload()
        if METRIC not in self.events.Tags()["scalars"]:
            return []
        epochs = {event.step: int(event.value) for event in self.events.Scalars("epoch")}
        found = [(event.step, float(event.value)) for event in self.events.Scalars(METRIC)]
        return [(epochs.get(step, place), step, value) for place, (step, value) in enumerate(found)]

    def score(self) -> float:
        """The error of the best checkpoint of the final stage.

        Raises:
            UserError: if there is none, or it is not finite.
        """
        files = [self.folder / "checkpoints" / name for name in BEST]
        file = next((file for file in files if file.is_file()), None)
        values = self.validations()
        if file is None or not values:
            raise UserError("the run left no best checkpoint or no validation")
        step = read_checkpoint(file)["global_step"]
        value = [value for _, at, value in values if at <= step][-1]
        if not math.isfinite(value):
            raise UserError(f"{METRIC} of the best checkpoint is {value}")
        return value
