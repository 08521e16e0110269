"""What the callbacks share that write into TensorBoard."""

from lightning.pytorch import Trainer
from lightning.pytorch.loggers import TensorBoardLogger


def tensorboard(trainer: Trainer) -> TensorBoardLogger | None:
    """The TensorBoard logger of the process that writes; None elsewhere, and where nothing logs to TensorBoard."""
    if not trainer.is_global_zero:
        return None
    return next((logger for logger in trainer.loggers if isinstance(logger, TensorBoardLogger)), None)
