"""The baselines' lines in a run's charts: the last frame shown as it is, and moved by the ego's motion."""

from typing import Any

from lightning.pytorch import Callback, LightningModule, Trainer
from lightning.pytorch.utilities import rank_zero_info
from torch.utils.tensorboard import SummaryWriter

from envpred.callbacks.loggers import tensorboard
from envpred.errors import UserError
from envpred.metrics.windows import PerHorizon
from envpred.models import Forecaster, MovedLastFrame

# First part of what is logged of a baseline -> name of its TensorBoard run below the forecaster's.
STATIC, MOVED = "static", "moved"
LINES = {STATIC: "static_baseline", MOVED: "moved_last_frame"}


class Baselines(Callback):
    """Shows both baselines' validation error in the forecaster's own charts, `val/mse` and `val/mse_<horizon>`.

    TensorBoard draws lines of one tag into one chart if they are of different runs, so each baseline is one, below the
    forecaster's.  The static baseline's error is logged by the forecaster, as `static/mse`.  The moved last frame's is
    measured here, at the first validation of a run and on its windows: it does not change in training, so all later
    validations log the same `moved/mse`.
    """

    def __init__(self) -> None:
        self.moved: PerHorizon | None = None
        self.forecaster: MovedLastFrame | None = None  # only while it is being measured
        self.writers: dict[str, SummaryWriter] = {}

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Forget what another run's windows gave."""
        self.moved, self.forecaster = None, None

    def on_validation_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        if self.moved is not None or trainer.sanity_checking:
            return
        if isinstance(pl_module, Forecaster) and not isinstance(pl_module, MovedLastFrame):
            forecaster = MovedLastFrame(pl_module.variant, pl_module.given).to(pl_module.device)
            forecaster.trainer = trainer
            try:
                forecaster.setup("validate")
            except UserError as error:  # as where no training window is there to tell what enters
                rank_zero_info(f"no error of the moved last frame: {error}")
            else:
                self.forecaster = forecaster

    def on_validation_batch_end(
        self,
        trainer: Trainer,
        pl_module: LightningModule,
        outputs: Any,
        batch: Any,
        batch_idx: int,
        dataloader_idx: int = 0,
    ) -> None:
        if self.forecaster is not None:
            self.forecaster.validation_step(batch, batch_idx)

    def on_validation_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        if self.forecaster is not None:
            self.moved, self.forecaster = self.forecaster.scored()["mse"], None
        if self.moved is not None and isinstance(pl_module, Forecaster) and not trainer.sanity_checking:
            pl_module.log_error(f"{MOVED}/mse", self.moved)

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Draw the lines at the steps that the forecaster's own have."""
        logger = tensorboard(trainer)
        if logger is None or trainer.sanity_checking:
            return
        step = max(trainer.global_step - 1, 0)  # what Lightning logs of a validation has the number of the last step
        for name, value in trainer.callback_metrics.items():
            baseline, _, measure = name.partition("/")
            if baseline in LINES:
                if baseline not in self.writers:
                    self.writers[baseline] = SummaryWriter(f"{logger.log_dir}/{LINES[baseline]}")
                self.writers[baseline].add_scalar(f"val/{measure}", float(value), step)
        for writer in self.writers.values():
            writer.flush()

    def teardown(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        for writer in self.writers.values():
            writer.close()
        self.writers = {}


def moved_last_frame(trainer: Trainer) -> PerHorizon | None:
    """The moved last frame's error over the validation windows; None if it was not measured."""
    return next((c.moved for c in trainer.callbacks if isinstance(c, Baselines)), None)  # type: ignore[attr-defined]
