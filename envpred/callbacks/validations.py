"""Writes what each validation of a training found, and which of them the best checkpoints are of."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lightning.pytorch import Callback, LightningModule, Trainer
from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.trainer.states import TrainerFn

from envpred.errors import UserError
from envpred.gate import conform
from envpred.gate.runs import Best, Validation
from envpred.gate.runs import History as Schema
from envpred.results.validations import VALIDATIONS, Chosen, History
from envpred.store.files import write_json

MSE, STATIC = "val/mse", "static/mse"  # means over the horizons; each horizon's own has its name after a `_`


class Validations(Callback):
    """Replaces `validations.json` in the run's folder after each validation (see `envpred.results.validations`).

    What it knows is part of each checkpoint, so a resumed run goes on with the validations up to its checkpoint: those
    that a killed run made after it are told once, and those of a run that is resumed in another folder are kept.
    """

    def __init__(self) -> None:
        self.history = History([], {})

    def on_fit_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Replace the file of an earlier run in the same folder."""
        if not trainer.ckpt_path:
            self.history = History([], {})
        self.history = self.history._replace(ended=None)
        self._write(trainer)

    def on_validation_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self._note_checkpoints(trainer)

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        metrics = {name: float(value) for name, value in trainer.callback_metrics.items()}
        if trainer.state.fn != TrainerFn.FITTING or MSE not in metrics:
            return
        stage = getattr(pl_module, "stage", None)
        found = _validation(trainer.current_epoch, trainer.global_step, stage, metrics)
        if not trainer.sanity_checking:
            self.history.validations.append(found)
        elif math.isinf(trainer.num_sanity_val_steps):  # of all windows, before training from weights
            self.history = self.history._replace(initial=found)
        self._write(trainer)

    def on_train_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self._note_checkpoints(trainer)

    def on_fit_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Say that the training has reached its end, which an exit code alone does not."""
        self.history = self.history._replace(ended=trainer.current_epoch)
        self._write(trainer)

    def state_dict(self) -> dict[str, Any]:
        return self.history.as_json()

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        conform(state_dict, Schema, "validations of the checkpoint", "give another checkpoint")
        self.history = History.of(state_dict)

    def _note_checkpoints(self, trainer: Trainer) -> None:
        """Note the newest validation for each checkpoint that it has improved.

        Lightning lets checkpoints come last, so what a validation did to them shows before the next one.
        """
        place = len(self.history.validations) - 1
        if trainer.state.fn != TrainerFn.FITTING or place < 0:
            return
        noted: dict[str, Best] = {}
        for checkpoint in trainer.checkpoint_callbacks:
            if not isinstance(checkpoint, ModelCheckpoint) or checkpoint.best_model_score is None:
                continue  # the last one is kept whatever it is worth
            name, score = Path(checkpoint.best_model_path).name, float(checkpoint.best_model_score)
            known = self.history.best.get(name)
            new: Best = {"monitor": str(checkpoint.monitor), "score": score, "validation": place}
            noted[name] = known if known and known["score"] == score else new
        if noted != self.history.best:
            self.history = self.history._replace(best=noted)
            self._write(trainer)

    def _write(self, trainer: Trainer) -> None:
        folder = Path(trainer.log_dir or trainer.default_root_dir)  # all processes agree on it together
        if not trainer.is_global_zero or trainer.fast_dev_run:  # type: ignore[attr-defined]
            return
        try:
            folder.mkdir(parents=True, exist_ok=True)
            write_json(folder / VALIDATIONS, self.history.as_json())
        except OSError as error:
            raise UserError(f"{folder / VALIDATIONS}: cannot be written ({error.strerror}); make room") from None


def history(trainer: Trainer) -> History:
    """The validations of the training that has just ended."""
    found = next((c for c in trainer.callbacks if isinstance(c, Validations)), None)  # type: ignore[attr-defined]
    return History([], {}) if found is None else found.history


def best_validation(trainer: Trainer) -> Chosen | None:
    """The best checkpoint of the training that has just ended, and its validation; None if it kept none."""
    return history(trainer).chosen()


def _validation(epoch: int, step: int, stage: str | None, metrics: Mapping[str, float]) -> Validation:
    horizons = [name.removeprefix(f"{MSE}_") for name in metrics if name.startswith(f"{MSE}_")]
    return {
        "epoch": epoch,
        "step": step,
        "stage": stage,
        "val_mse": metrics[MSE],
        "static_mse": metrics[STATIC],
        "horizons": {
            horizon: {"val_mse": metrics[f"{MSE}_{horizon}"], "static_mse": metrics[f"{STATIC}_{horizon}"]}
            for horizon in horizons
        },
    }
