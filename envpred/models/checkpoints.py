"""Checkpoints: the best of each training stage, and reading them as weights only."""

import os
import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, cast

import torch
from lightning.fabric.plugins import TorchCheckpointIO
from lightning.pytorch import LightningModule, Trainer
from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.trainer.states import TrainerFn
from lightning.pytorch.utilities import rank_zero_info

from envpred.errors import UserError, short
from envpred.gate import conform
from envpred.gate.arrays import DAMAGED
from envpred.gate.runs import Checkpoint, Progress
from envpred.models import checksums
from envpred.store.files import replaced

LIKE_THAT = "build a store like that which it was trained on"


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


class OwnFiles(TorchCheckpointIO):
    """Checkpoints as files with a checksum that are replaced in one step; nothing but a file is ever removed.

    Lightning writes them where temporary files lie: from another disk than the target's they are copied, over the
    one before.
    """

    def save_checkpoint(self, checkpoint: dict[str, Any], path: str | Path, storage_options: Any = None) -> None:
        if "://" in str(path):  # of a user's own callback; what comes from a checkpoint has no such path
            super().save_checkpoint(checkpoint, path, storage_options)
            return
        file = Path(path)
        file.parent.mkdir(parents=True, exist_ok=True)
        with replaced(file) as part:
            checksums.save(checkpoint, part)

    def load_checkpoint(self, path: str | Path, *args: Any, **options: Any) -> dict[str, Any]:
        if "://" not in str(path):
            check_content(Path(path))
        loaded: dict[str, Any] = super().load_checkpoint(path, *args, **options)
        return loaded

    def remove_checkpoint(self, path: str | Path) -> None:
        if "://" in str(path):
            super().remove_checkpoint(path)
            return
        file = Path(path)
        if file.is_file():
            file.unlink()


def keep_own_files(trainer: Trainer) -> None:
    """Let a trainer keep its checkpoints by `OwnFiles`, unless it keeps them in a way of the user's or a strategy's."""
    if type(trainer.strategy.checkpoint_io) is TorchCheckpointIO:
        trainer.strategy.checkpoint_io = OwnFiles()


BEST = {"best_model_path", "best_model_score"}  # what Lightning reads of a checkpoint's callbacks


def trust_no_path(checkpoint: Mapping[str, Any], trainer: Trainer) -> None:
    """Let what a checkpoint says of other checkpoints' paths stand for files of their names beside it.

    Lightning removes what they name.  Where a run is resumed in its own folder, they are written as the trainer writes
    them, whatever folder the command is run in.

    Raises:
        UserError: if it does not say which was best where it should.
    """
    folder = Path(str(trainer.ckpt_path)).parent
    own = [str(c.dirpath) for c in trainer.checkpoint_callbacks if isinstance(c, ModelCheckpoint) and c.dirpath]
    written = next((d for d in own if Path(d).resolve() == folder.resolve()), str(folder))

    def beside(path: object) -> str:
        name = Path(str(path)).name
        return os.path.join(written, name) if name.endswith(ModelCheckpoint.FILE_EXTENSION) else ""

    for state in checkpoint.get("callbacks", {}).values():
        if isinstance(state, dict) and state.keys() & BEST:
            if not state.keys() >= BEST or not isinstance(state.get("best_k_models", {}), dict):
                raise UserError("the checkpoint does not tell which of its run was best; give another checkpoint")
            for name in ("best_model_path", "kth_best_model_path", "last_model_path"):
                state[name] = beside(state.get(name, ""))
            best = {beside(path): score for path, score in dict(state.get("best_k_models", {})).items()}
            state.update(dirpath=written, best_k_models=best)


def read_checkpoint(file: Path, device: torch.device | str = "cpu") -> dict[str, Any]:
    """A checkpoint of ours; weights and plain values alone, never code.

    Raises:
        UserError: if the file is missing, damaged, no checkpoint, or holds more than weights.
    """
    summed = check_content(file)
    try:
        checkpoint = torch.load(file, map_location=device, weights_only=True)
    except pickle.UnpicklingError:
        raise UserError(f"{file}: holds more than weights, so it is not loaded; give a checkpoint of envpred") from None
    except DAMAGED:
        raise UserError(f"{file}: damaged or no checkpoint; {_another(file)}") from None
    conform(checkpoint, Checkpoint, file, "give a checkpoint that `envpred fit` wrote")
    if not summed:
        rank_zero_info(f"{file}: carries no checksum, so damage to its weights would not be noticed")
    return cast(dict[str, Any], checkpoint)


def check_loops(checkpoint: Mapping[str, Any], trainer: Trainer) -> None:
    """Refuse a checkpoint that does not tell how far a training came as `trainer` tells it, or came further than asked.

    Raises:
        UserError: naming what differs.
    """
    names = ("fit_loop", "validate_loop", "test_loop", "predict_loop")
    differs = _unlike(checkpoint.get("loops"), {name: getattr(trainer, name).state_dict() for name in names}, "loops")
    if differs:
        raise UserError(f"the checkpoint does not tell how far it was trained ({differs}); give another checkpoint")
    done, asked = checkpoint["epoch"] + 1, trainer.max_epochs  # it is saved at an epoch's end
    resumes = trainer.state.fn == TrainerFn.FITTING and trainer.ckpt_path  # not so where weights alone are taken
    if resumes:
        conform(
            checkpoint, Progress, "the checkpoint", "give one that `envpred fit` wrote, or start anew from its weights"
        )
    if resumes and asked not in (None, -1) and done > asked:
        raise UserError(
            f"the checkpoint has been trained for {done} epochs, the command says {asked}; give it as many or more, or "
            "another checkpoint"
        )


def _unlike(theirs: Any, ours: Any, name: str) -> str | None:
    """The first part of `theirs` that is missing or of another type than in `ours`; both are nested plain data."""
    if not isinstance(ours, dict):
        return None if type(theirs) is type(ours) else name
    if not isinstance(theirs, dict):
        return name
    found = (_unlike(theirs.get(key), value, f"{name}.{key}") for key, value in ours.items() if value is not None)
    return next((part for part in found if part), None)


def check_weights(checkpoint: Mapping[str, Any], forecaster: LightningModule, what: str = "the checkpoint") -> None:
    """Refuse weights that are not those of a forecaster, by their names and shapes; a message calls them `what`'s.

    Raises:
        UserError: naming the first that differs.
    """
    theirs, ours = checkpoint["state_dict"], forecaster.state_dict()
    for name in [*ours, *theirs]:
        shapes = [tuple(getattr(held.get(name), "shape", ())) if name in held else None for held in (theirs, ours)]
        if shapes[0] != shapes[1] or not isinstance(theirs[name], torch.Tensor):
            raise UserError(
                f"{what}'s weights are not those of this {type(forecaster).__name__}: {short(name)} is "
                f"{shapes[0]}, not {shapes[1]}; give its own model configuration, or another checkpoint"
            )


def check_content(file: Path) -> bool:
    """Refuse a checkpoint that has changed since it was saved; returns whether that can be told.

    Raises:
        UserError: if it is missing or damaged.
    """
    try:
        return checksums.check(file)
    except FileNotFoundError:
        raise UserError(
            f"{file}: no such checkpoint; `envpred fit` writes them into its run's folder checkpoints/"
        ) from None
    except (OSError, ValueError):
        raise UserError(f"{file}: damaged or no checkpoint; {_another(file)}") from None


def check_grids(
    trained: Mapping[str, Any],
    here: Mapping[str, Any],
    context: bool,
    whose: object,
    remedy: str = LIKE_THAT,
    what: str = "the checkpoint",
) -> None:
    """Refuse grids of another time base, cell or size (with `context`, also around them) than weights were trained on.

    Args:
        trained: what the weights were trained on.
        here: what the grids are, see `GridDataModule.grids`.
        context: whether the wide grid counts.
        whose: the grids are.
        remedy: what else to do than to give another checkpoint.
        what: was trained.

    Raises:
        UserError: naming what differs.
    """
    for name, unit in (("period", " s"), ("resolution", " m"), ("cells", " cells"), ("context", " cells of context")):
        if trained.get(name) != here[name] and not (name == "context" and not context):
            raise UserError(
                f"{what} was trained on grids of {trained.get(name)}{unit}, {whose} has "
                f"{here[name]}{unit}; {remedy}, or give another checkpoint"
            )


def _another(damaged: Path) -> str:
    """What to do instead: the newest checkpoint beside a damaged one that can be read."""
    written = sorted(damaged.parent.glob("*.ckpt"), key=lambda file: file.stat().st_mtime_ns, reverse=True)
    for file in (file for file in written if file.name != damaged.name):
        try:
            checksums.check(file)
            torch.load(file, "meta", weights_only=True)
        except (*DAMAGED, pickle.UnpicklingError):
            continue
        return f"give another one, such as {file}"
    return "give another one, or train it again"
