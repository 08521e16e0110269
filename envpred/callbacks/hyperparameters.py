"""A run's row in TensorBoard's HPARAMS: what it was trained with, and what became of it."""

from typing import Any

from lightning.pytorch import Callback, LightningModule, Trainer
from torch.utils.tensorboard.summary import hparams

from envpred.callbacks.loggers import tensorboard
from envpred.callbacks.validations import MSE, best_validation
from envpred.models import Forecaster
from envpred.models.origins import seed

FINAL = "final/val_mse"  # of the best checkpoint; where none is kept, of the last validation
DATA = ("split", "length", "samples", "batch_size", "augment", "crop", "seed")  # what is told of the data module
TRAINER = ("gradient_clip_val", "accumulate_grad_batches", "precision")  # and of the trainer


class Hyperparameters(Callback):
    """Writes the row: hyperparameters and the metric's name at the start, its value and that the run ended at the end.

    A run that goes on or was killed has a row without a value.
    """

    def __init__(self) -> None:
        self.end: Any = None  # TensorBoard's record of the end

    def on_fit_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        logger = tensorboard(trainer)
        if logger is None or not isinstance(pl_module, Forecaster):
            return
        told = dict(pl_module.hparams)
        told |= {f"data.{name}": getattr(pl_module.dataset, name) for name in DATA}
        told |= {f"trainer.{name}": getattr(trainer, name) for name in TRAINER}
        told["seed_everything"] = seed()
        shown = {
            name: value if isinstance(value, int | float | str | bool) else str(value) for name, value in told.items()
        }
        # Not Lightning's `log_hyperparams`: it wants a value of the metric before there is one.
        experiment, start, self.end = hparams(shown, {FINAL: None})  # type: ignore[no-untyped-call]
        for record in (experiment, start):
            logger.experiment._get_file_writer().add_summary(record)

    def on_fit_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        logger = tensorboard(trainer)
        if logger is None or self.end is None:
            return
        best, last = best_validation(trainer), trainer.callback_metrics.get(MSE)
        value = best.validation["val_mse"] if best is not None else last
        if value is not None:
            logger.log_metrics({FINAL: float(value)}, trainer.global_step)
        logger.experiment._get_file_writer().add_summary(self.end)
        self.end = None
