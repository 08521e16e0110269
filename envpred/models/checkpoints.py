"""Checkpoints: the best of each training stage, and reading them as weights only."""

import pickle
from pathlib import Path
from typing import Any, Literal

import torch
from lightning.pytorch import LightningModule, Trainer
from lightning.pytorch.callbacks import ModelCheckpoint

from envpred.errors import UserError


class StageCheckpoint(ModelCheckpoint):
    """Keeps the best weights of one training stage, judged by that stage's own validation loss."""

    def __init__(self, stage: Literal["t1", "t5"], filename: str) -> None:
        super().__init__(
            monitor=f"val/loss_{stage}",
            filename=filename,
            auto_insert_metric_name=False,
            save_on_train_epoch_end=True,  # after validation, when the epoch is counted: resuming starts the next one
            enable_version_counter=False,
        )
        self.stage = stage

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        if pl_module.stage == self.stage and self.monitor in trainer.callback_metrics:
            super().on_train_epoch_end(trainer, pl_module)

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Go on with the best score so far, also where a resumed run writes to another folder."""
        super().load_state_dict(state_dict | {"dirpath": self.dirpath})


def read_checkpoint(file: Path, device: torch.device | str = "cpu") -> dict[str, Any]:
    """A checkpoint of ours; weights and plain values alone, never code.

    Raises:
        UserError: if the file is missing, damaged, no checkpoint, or holds more than weights.
    """
    try:
        checkpoint = torch.load(file, map_location=device, weights_only=True)
    except FileNotFoundError:
        raise UserError(
            f"{file}: no such checkpoint; `envpred fit` writes them into its run's folder checkpoints/"
        ) from None
    except pickle.UnpicklingError:
        raise UserError(f"{file}: holds more than weights, so it is not loaded; give a checkpoint of envpred") from None
    except (OSError, RuntimeError, EOFError, ValueError):
        raise UserError(f"{file}: damaged or no checkpoint; give another one, such as last.ckpt beside it") from None
    if not isinstance(checkpoint, dict) or "state_dict" not in checkpoint:
        raise UserError(f"{file}: no checkpoint of a forecaster; give one that `envpred fit` wrote")
    return checkpoint
