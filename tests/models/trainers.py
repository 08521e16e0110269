"""Trainers and tiny forecasters for tests."""

from pathlib import Path
from typing import Any, cast

from lightning.pytorch import Trainer, seed_everything
from lightning.pytorch.loggers import CSVLogger
from torch import Tensor

from envpred.callbacks import ResultWriter
from envpred.datamodules import GridDataModule, Seen
from envpred.models import PredNetForecaster

# What every checkpoint of Lightning holds.
LEAST: dict[str, Any] = {"state_dict": {}, "epoch": 0, "global_step": 0, "pytorch-lightning_version": "2.6.0"}


def trainer(folder: Path, **options: Any) -> Trainer:
    """A quiet trainer on the CPU that writes into `folder`."""
    defaults: dict[str, Any] = {
        "accelerator": "cpu",
        "logger": CSVLogger(str(folder), name="", version="", flush_logs_every_n_steps=1),
        "enable_progress_bar": False,
        "enable_model_summary": False,
        "log_every_n_steps": 1,
        "max_epochs": -1,  # the forecaster's own schedule ends it
        "num_sanity_val_steps": 0,
    }
    options["callbacks"] = [ResultWriter(), *options.get("callbacks", [])]
    return Trainer(**(defaults | options))


def seen(**fields: Tensor) -> Seen:
    """What a forecaster sees, as far as a test needs it."""
    return cast(Seen, fields)


def prednet(**options: Any) -> PredNetForecaster:
    """A PredNet of two small layers, three epochs a stage."""
    seed_everything(3, verbose=False)
    defaults: dict[str, Any] = {
        "given": 3,
        "channels": [4],
        "t1_epochs": 3,
        "t1_lr": 2e-3,
        "t1_drop_epoch": 2,
        "t5_epochs": 3,
        "t5_lr": 1e-3,
        "t5_drop_epoch": 2,
    }
    return PredNetForecaster(**(defaults | options))


def grids(store: Path, **options: Any) -> GridDataModule:
    """Four random windows of 8 frames an epoch, turned at random."""
    defaults: dict[str, Any] = {"length": 8, "given": 3, "samples": 4, "augment": True}
    return GridDataModule(store, **(defaults | options))
