"""What a training leaves of its validations: `validations.json` in the run's folder, replaced after each of them.

    {"validations": [{"epoch": 0, "step": 500, "stage": "t1", "val_mse": 0.021, "static_mse": 0.024,
                      "horizons": {"0.5s": {"val_mse": 0.014, "static_mse": 0.015}, ...}}, ...],
     "best": {"best_t1.ckpt": {"monitor": "val/loss_t1", "score": 0.0312, "validation": 3}, ...},
     "ended": null, "initial": null}

`val_mse` and `static_mse`, the static baseline's, are means over windows and horizons.  The stage is null where a model
has no stages.  `best` says of each checkpoint that a validation decides on which one that was: its place in the list.
`ended` is null until the training has reached its end, then the epochs that it took.  `initial` is the validation
before training where that started from weights, else null.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from envpred.gate import read_json
from envpred.gate.runs import Best, Validation
from envpred.gate.runs import History as Schema

VALIDATIONS = "validations.json"


class Chosen(NamedTuple):
    """The best checkpoint of the final stage, by its name in the run's folder `checkpoints`, and its validation."""

    checkpoint: str
    validation: Validation


class History(NamedTuple):
    """The validations of a run so far, and which of them the checkpoints are of."""

    validations: list[Validation]
    best: dict[str, Best]
    ended: int | None = None
    initial: Validation | None = None

    @classmethod
    def of(cls, told: Mapping[str, Any]) -> "History":
        """What a file, or a checkpoint, tells."""
        return cls(told["validations"], told["best"], told.get("ended"), told.get("initial"))

    def as_json(self) -> dict[str, Any]:
        """What stands in the file."""
        return {**self._asdict(), "validations": list(self.validations), "best": dict(self.best)}

    def chosen(self) -> Chosen | None:
        """The best checkpoint of the stage that the last validation is of; None where none was kept."""
        if not self.validations:
            return None
        final = self.validations[-1]["stage"]
        of_final = {name: self.validations[best["validation"]] for name, best in self.best.items()}
        kept = [Chosen(name, validation) for name, validation in of_final.items() if validation["stage"] == final]
        return kept[-1] if kept else None  # the model's own come after those that a user adds


def read_validations(folder: Path) -> History:
    """The validations of the run in `folder`, also while it goes on; none if it has not validated yet.

    Raises:
        UserError: if their file cannot be read, or does not fit together.
    """
    if not (folder / VALIDATIONS).exists():
        return History([], {})
    told = read_json(folder / VALIDATIONS, Schema, f"delete {folder} and train again")
    return History.of(told)
