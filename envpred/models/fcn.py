"""FCN as a forecaster: one grid in, one map of probability per horizon out (Itkina et al. 2019, IV-B)."""

from typing import Any

import torch
from lightning.pytorch.callbacks import Callback, ModelCheckpoint
from torch import Tensor

from envpred.datamodules import WindowBatch
from envpred.errors import UserError
from envpred.models.forecaster import Forecaster
from envpred.networks.fcn import FCN8s


class FCNForecaster(Forecaster):
    """FCN-8s with a VGG-16 trunk, which forecasts from the last grid shown alone; l1 loss.

    Args:
        variant: input variant; the paper's is prob_dogma.
        given: frames shown, of which it reads the last.
        horizons: forecasts, the first 0.1 s ahead.
        width: factor on the channels of every layer; 1 is VGG-16's.
        dropout: of the head.
        lr: learning rate of Adam.
        max_epochs: epochs of training.
    """

    shaping = ("variant", "horizons", "width")

    def __init__(
        self,
        variant: str = "dst_static",
        given: int = 5,
        horizons: int = 15,
        width: float = 1.0,
        dropout: float = 0.5,
        lr: float = 1e-4,
        max_epochs: int = 198,
    ) -> None:
        super().__init__(variant, given)
        self.save_hyperparameters()
        self.network = FCN8s(len(self.view.channels), horizons, width, dropout)

    @property
    def epochs(self) -> int:
        return int(self.hparams["max_epochs"])

    def setup(self, stage: str) -> None:
        super().setup(stage)
        horizons = self.dataset.length - self.dataset.given
        if horizons > self.hparams["horizons"]:
            raise UserError(
                f"--model.horizons {self.hparams['horizons']}: windows of {self.dataset.length} frames with "
                f"{self.dataset.given} shown need {horizons} forecasts; give "
                f"--data.length {self.dataset.given + self.hparams['horizons']} or less"
            )

    def forecast(self, batch: WindowBatch, given: int = 5, horizons: int | None = None) -> Tensor:
        frames = batch["frames"]
        maps: Tensor = self.network(frames[:, given - 1])
        return maps[:, : frames.shape[1] - given if horizons is None else horizons]

    def training_step(self, batch: WindowBatch, batch_index: int) -> Tensor:
        loss = (self.forecast(batch, self.given) - batch["occupancy"][:, self.given :]).abs().mean()
        self.log("train/loss", loss, prog_bar=True, batch_size=len(batch["frames"]))
        return loss

    def configure_optimizers(self) -> torch.optim.Adam:
        return torch.optim.Adam(self.parameters(), lr=self.hparams["lr"])

    def configure_callbacks(self) -> list[Callback]:
        """The best checkpoint by validation error, and the last to resume from."""
        if not any(isinstance(c, ModelCheckpoint) for c in self.trainer.callbacks):  # type: ignore[attr-defined]
            return []  # checkpoints are switched off
        options: dict[str, Any] = {"save_on_train_epoch_end": True, "enable_version_counter": False}
        return [
            ModelCheckpoint(monitor="val/mse", filename="best", auto_insert_metric_name=False, **options),
            ModelCheckpoint(filename="last", **options),
        ]
