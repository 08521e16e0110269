"""What weights come from: told beside them, and compared with the forecaster that is to take them."""

import os
import sys
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import torch

from envpred.errors import UserError
from envpred.models.checkpoints import check_weights
from envpred.results.result import revision

if TYPE_CHECKING:
    from envpred.models.forecaster import Forecaster


class Clock:
    """Seconds that a training took, those before it was resumed included."""

    def __init__(self) -> None:
        self.begun, self.before = time.perf_counter(), 0.0

    def resume(self, trained: Mapping[str, Any] | None) -> None:
        """Go on from what a checkpoint tells."""
        self.begun, self.before = time.perf_counter(), float((trained or {}).get("seconds", 0.0))

    @property
    def seconds(self) -> float:
        return round(self.before + time.perf_counter() - self.begun, 1)


def training(forecaster: "Forecaster") -> dict[str, Any]:
    """What the weights of a training come from, as plain data that goes with them."""
    told = forecaster.dataset.describe("train")
    del told["windows"]
    return {
        "data": told,
        "seed": seed(),
        "hyperparameters": dict(forecaster.hparams),
        "command": " ".join(["envpred", *sys.argv[1:]]),
        "revision": revision(),
        "seconds": forecaster.clock.seconds,
        "threads": torch.get_num_threads(),
    }


def check_origin(checkpoint: Mapping[str, Any], forecaster: "Forecaster", what: str) -> None:
    """Refuse weights of another forecaster or variant, or of another shape.

    Args:
        checkpoint: what holds them and says what they are of.
        forecaster: that is to take them.
        what: how a message calls the checkpoint.

    Raises:
        UserError: naming what differs.
    """
    own = type(forecaster).__name__
    kind = checkpoint.get("forecaster", own)
    if kind != own:
        raise UserError(f"{what} holds a {kind}, not a {own}; give its own model configuration")
    theirs = checkpoint.get("hyper_parameters", {})
    for name in forecaster.shaping:
        if name in theirs and theirs[name] != forecaster.hparams[name]:
            room = "data" if name == "variant" else "model"
            raise UserError(
                f"{what} was trained with {name} {theirs[name]}, the command says {forecaster.hparams[name]}; "
                f"give --{room}.{name} {_argument(theirs[name])}, or another checkpoint"
            )
    check_weights(checkpoint, forecaster, what)


def seed() -> int | None:
    """The seed of --seed_everything, if there is one."""
    value = os.environ.get("PL_GLOBAL_SEED")
    return int(value) if value is not None else None


def _argument(value: Any) -> str:
    """A hyperparameter as it is written on the command line."""
    return f"'{value}'" if isinstance(value, list) else str(value)
