"""What all forecasters share: validation, test and prediction are written once, here; only training differs."""

import time
from abc import abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, cast

import torch
from lightning.pytorch import LightningModule
from lightning.pytorch.utilities import rank_zero_info
from torch import Tensor
from torch.utils.flop_counter import FlopCounterMode
from torchmetrics import MetricCollection

from envpred.datamodules import GridDataModule, WindowBatch
from envpred.datamodules.variants import variant as variant_of
from envpred.errors import UserError
from envpred.horizons import horizon_name, shown_steps
from envpred.metrics.collection import forecast_metrics
from envpred.metrics.horizon_mse import HorizonMSE
from envpred.results.result import write_test_result


class Forecaster(LightningModule):
    """A model of the probability of occupied in the frames after those shown.

    Args:
        variant: input variant that it reads; its data module's.
        given: frames shown before the first that is forecast; its data module's.
    """

    # Hyperparameters that decide which weights there are; a checkpoint with others does not fit.
    shaping: tuple[str, ...] = ("variant",)
    # What kind of forecaster it is, which reports go by.
    role: Literal["static", "moved", "particle", "rollout", "oracle", "learned"] = "learned"
    # Stored array that it reads beside its variant, at the last frame shown.
    extra: str | None = None

    def __init__(self, variant: str, given: int) -> None:
        super().__init__()
        self.variant, self.given = variant, given
        self.view = variant_of(variant)
        self.scores, self.static = MetricCollection({}), HorizonMSE()
        self.forecast_seconds = 0.0

    @abstractmethod
    def forecast(self, batch: WindowBatch, given: int = 5, horizons: int | None = None) -> Tensor:
        """Probability of occupied (B, horizons, H, W) in [0, 1] of the frames after the first `given`.

        By default of as many as the batch holds after those; a forecaster that reads the `given` frames alone may be
        asked for any number, of a batch that holds no more.
        """

    def configure_optimizers(self) -> torch.optim.Optimizer | None:
        """The optimiser; a forecaster without parameters has none."""
        return None

    @property
    def epochs(self) -> int:
        """Epochs that training takes."""
        return 0

    def flops(self, length: int, given: int) -> int | None:
        """Floating-point operations of the forecast of one window of `length` frames (a multiply-add is two).

        Those of convolutions and matrix products, counted as they run; None where nothing is learned.
        """
        if not any(True for _ in self.parameters()):
            return None
        cells = self.dataset.cells
        frames = torch.zeros(1, length, len(self.view.channels), cells, cells, device=self.device)
        batch = cast(WindowBatch, {"frames": frames, "occupancy": frames[:, :, 0]})
        with torch.no_grad(), FlopCounterMode(display=False) as counter:
            self.forecast(batch, given)
        return int(counter.get_total_flops())

    @property
    def dataset(self) -> GridDataModule:
        """The data module of the trainer."""
        data: GridDataModule = self.trainer.datamodule  # type: ignore[attr-defined]
        return data

    def setup(self, stage: str) -> None:
        horizons = self.dataset.length - self.dataset.given
        self.static = HorizonMSE(horizons).to(self.device)
        chosen = forecast_metrics(horizons) if stage == "test" else MetricCollection({"mse": HorizonMSE(horizons)})
        self.scores = chosen.to(self.device)

    def score(self, batch: WindowBatch, forecast: Tensor) -> None:
        """Count a batch's forecast, and the last frame shown as the static baseline's."""
        target, last = batch["occupancy"][:, self.given :], batch["occupancy"][:, self.given - 1]
        self.scores.update(forecast, target, last, batch["index"])
        self.static.update(last[:, None].expand_as(target), target, last, batch["index"])

    def scored(self) -> dict[str, Any]:
        """Every metric over all windows counted, which are then forgotten; `static_mse` is the static baseline's."""
        found = self.scores.compute() | {"static_mse": self.static.compute()}
        self.scores.reset()
        self.static.reset()
        return found

    def validation_step(self, batch: WindowBatch, batch_index: int) -> None:
        self.score(batch, self.forecast(batch, self.given))

    def on_validation_epoch_end(self) -> None:
        found = self.scored()
        mse, static = found["mse"], found["static_mse"]
        self.log("val/mse", mse.mean.mean().float(), prog_bar=True)
        self.log("val/skill", (1 - mse.mean.mean() / static.mean.mean()).float())
        for horizon in shown_steps(len(mse.mean)):
            self.log(f"val/mse_{horizon_name(horizon)}", mse.mean[horizon - 1].float())
            self.log(f"static/mse_{horizon_name(horizon)}", static.mean[horizon - 1].float())

    def test_step(self, batch: WindowBatch, batch_index: int) -> None:
        start = time.perf_counter()
        forecast = self.forecast(batch, self.given)
        if forecast.is_cuda:
            torch.cuda.synchronize()
        self.forecast_seconds += time.perf_counter() - start
        self.score(batch, forecast)

    def on_test_epoch_end(self) -> None:
        found = self.scored()
        mse, skill = found["mse"], found["skill"]
        for horizon in shown_steps(len(mse.mean)):
            self.log(f"test/mse_{horizon_name(horizon)}", mse.mean[horizon - 1].float())
            self.log(f"test/skill_{horizon_name(horizon)}", skill.value[horizon - 1].float())
        metrics = {name: value.as_json() for name, value in found.items()}
        folder = Path(self.trainer.log_dir or self.trainer.default_root_dir)  # all processes agree on it together
        if self.trainer.is_global_zero and not self.trainer.fast_dev_run:  # type: ignore[attr-defined]
            file = write_test_result(self, folder, metrics, self.forecast_seconds / max(len(mse.index), 1))
            rank_zero_info(f"result: {file}")
        self.forecast_seconds = 0.0

    def predict_step(self, batch: WindowBatch, batch_index: int) -> Mapping[str, Any]:
        """The forecast (B, horizons, H, W) of a batch, and which windows it belongs to."""
        return {
            "forecast": self.forecast(batch, self.given, self.dataset.length - self.dataset.given),
            "drive": batch["drive"],
            "start": batch["start"],
            "index": batch["index"],
        }

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        checkpoint["forecaster"] = type(self).__name__

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Refuse a checkpoint whose weights belong to another forecaster or variant.

        Raises:
            UserError: naming what differs.
        """
        kind = checkpoint.get("forecaster", type(self).__name__)
        if kind != type(self).__name__:
            raise UserError(
                f"the checkpoint holds a {kind}, not a {type(self).__name__}; give its own model configuration"
            )
        theirs = checkpoint.get("hyper_parameters", {})
        for name in self.shaping:
            if name in theirs and theirs[name] != self.hparams[name]:
                room = "data" if name == "variant" else "model"
                raise UserError(
                    f"the checkpoint was trained with {name} {theirs[name]}, the command says {self.hparams[name]}; "
                    f"give --{room}.{name} {_argument(theirs[name])}, or another checkpoint"
                )


def _argument(value: Any) -> str:
    """A hyperparameter as it is written on the command line."""
    return f"'{value}'" if isinstance(value, list) else str(value)
