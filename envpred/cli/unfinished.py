"""What fit, validate, test and predict say where they are ended before their end, and the exit code that tells so."""

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from lightning.pytorch import Callback, Trainer
from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.trainer.states import TrainerFn
from lightning.pytorch.utilities.exceptions import SIGTERMException

from envpred.interrupts import MESSAGE, Terminated, exit_code, heed, noted, tell
from envpred.models.checkpoints import read_checkpoint


@contextmanager
def told_if_ended(trainer: Trainer) -> Iterator[None]:
    """End with one line and an exit code of its own where a signal ends what a trainer does.

    Lightning ends with 0 after SIGTERM, as if the training were complete, and with 1 after Ctrl-C.
    """
    logging.getLogger("lightning.pytorch.utilities.rank_zero").addFilter(_no_announcement)  # the line below says more
    try:
        with noted():
            trainer.callbacks.append(_Heeded())  # type: ignore[attr-defined]
            yield
    except (KeyboardInterrupt, SIGTERMException) as ended:
        if trainer.is_global_zero:
            tell(_line(trainer))
        interrupt = ended if isinstance(ended, KeyboardInterrupt) else Terminated()  # of another process of a training
        sys.exit(exit_code(interrupt))


class _Heeded(Callback):
    """Ends what a trainer does also where a library has swallowed the exception of a signal."""

    def _heed(self, *_: Any, **__: Any) -> None:
        heed()

    on_train_batch_start = on_validation_batch_start = on_test_batch_start = on_predict_batch_start = _heed


def _line(trainer: Trainer) -> str:
    """What was saved, and how to go on."""
    if trainer.state.fn != TrainerFn.FITTING:
        return MESSAGE
    kept = [Path(c.dirpath) for c in trainer.checkpoint_callbacks if isinstance(c, ModelCheckpoint) and c.dirpath]
    last = next((folder / "last.ckpt" for folder in kept if (folder / "last.ckpt").is_file()), None)
    # The trainer counts an epoch after its checkpoint is saved, and may be interrupted between both.
    epochs = trainer.current_epoch if last is None else int(read_checkpoint(last, "meta")["epoch"]) + 1
    done = f"envpred: interrupted after {epochs} of {trainer.max_epochs} epochs"
    if last is None:
        return f"{done}, before the first checkpoint; run the same command again"
    return f"{done}; run the same command again with --ckpt_path {last} to go on"


def _no_announcement(record: logging.LogRecord) -> bool:
    """Whether a line says more than that Lightning has heard Ctrl-C."""
    return "Detected KeyboardInterrupt" not in record.getMessage()
