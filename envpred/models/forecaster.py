"""What all forecasters share: validation, test and prediction are written once, here; only training differs.

A new forecaster is one file: a subclass that implements `forecast`, and says what it needs, what it is, how it trains.
One with the argument `init_from` can start training from weights of its kind.
"""

import math
import time
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, cast

import torch
from lightning.pytorch.callbacks import Callback, ModelCheckpoint
from lightning.pytorch.utilities import rank_zero_info
from torch.utils.flop_counter import FlopCounterMode
from torchmetrics import MetricCollection

from envpred.datamodules import Forecast, GridDataModule, Needs, Role, Seen, WindowBatch
from envpred.datamodules.seen import seen_of
from envpred.datamodules.variants import variant as variant_of
from envpred.datamodules.windows import collate
from envpred.errors import UserError
from envpred.gate.weights import found
from envpred.horizons import horizon_name, shown_steps
from envpred.mapping.mapper import Mapped, Mapper
from envpred.metrics.collection import forecast_metrics
from envpred.metrics.horizon_mse import HorizonMSE
from envpred.metrics.windows import PerHorizon, WindowMetric
from envpred.models.checkpoints import check_grids, check_loops, keep_own_files, read_checkpoint, trust_no_path
from envpred.models.kinds import kinds_of
from envpred.models.numbers import NumberedLoss, as_asked, check_forecast, check_metrics
from envpred.models.origins import Clock, check_origin, training
from envpred.models.weights import Weights


class Forecaster(NumberedLoss):
    """A model of the probability of occupied in the frames after those shown.

    Args:
        variant: input variant that it reads; its data module's.
        given: frames shown before the first that is forecast; its data module's.
    """

    # What it reads beside its variant's frames; where that depends on arguments, an instance says so itself.
    needs: Needs = Needs()
    # What it is, for tables and pictures: a baseline says so, and whoever reads the future is an oracle.
    role: ClassVar[Role] = "learned"
    # Hyperparameters that decide which weights there are; a checkpoint with others does not fit.
    shaping: ClassVar[tuple[str, ...]] = ("variant",)

    def __init__(self, variant: str = "dst_static", given: int = 5) -> None:
        super().__init__()
        if self.needs.future_pose != (self.role == "oracle"):
            raise TypeError(f"{type(self).__name__}: whoever needs future poses is an oracle, and nobody else")
        self.variant, self.given = variant, given
        self.view = variant_of(variant)
        self.scores, self.static = MetricCollection({}), HorizonMSE()
        self.extra_metrics: Sequence[Callable[[int], WindowMetric]] = ()
        self.validated: dict[str, Any] = {}  # what the last validation found, and the last test
        self.tested: dict[str, Any] = {}
        self.trained: dict[str, Any] | None = None  # what the weights come from
        self.origin = "the checkpoint"  # how messages call where they come from
        self.clock = Clock()
        self.forecast_seconds, self.forecast_windows = 0.0, 0

    @abstractmethod
    def forecast(self, seen: Seen, horizons: int) -> Forecast:
        """The forecast of the `horizons` frames that follow what is seen."""

    @property
    def epochs(self) -> int | None:
        """Epochs that training takes; None leaves them to the trainer."""
        return 0 if self.is_fixed else None

    @property
    def reachable(self) -> int | None:
        """Horizons that it can forecast at most; None for any number."""
        return None

    @property
    def is_fixed(self) -> bool:
        """Whether it has no parameters, so that there is nothing to train."""
        return not any(True for _ in self.parameters())

    def configure_optimizers(self) -> Any:
        """The optimiser; a forecaster without parameters has none."""
        return None if self.is_fixed else torch.optim.Adam(self.parameters(), lr=1e-3)

    def configure_callbacks(self) -> list[Callback]:
        """The best checkpoint by validation error, and the last to resume from."""
        if self.is_fixed or not self.keeps_checkpoints:
            return []
        options: dict[str, Any] = {"save_on_train_epoch_end": True, "enable_version_counter": False}
        return [
            ModelCheckpoint(monitor="val/mse", filename="best", auto_insert_metric_name=False, **options),
            ModelCheckpoint(filename="last", **options),
        ]

    @property
    def keeps_checkpoints(self) -> bool:
        """Whether the trainer keeps checkpoints at all."""
        return any(isinstance(c, ModelCheckpoint) for c in self.trainer.callbacks)  # type: ignore[attr-defined]

    @property
    def dataset(self) -> GridDataModule:
        """The data module of the trainer."""
        data: GridDataModule = self.trainer.datamodule  # type: ignore[attr-defined]
        return data

    def setup(self, stage: str) -> None:
        keep_own_files(self.trainer)
        horizons = self.dataset.horizons
        if self.reachable is not None and horizons > self.reachable:
            raise UserError(
                f"{type(self).__name__} reaches {self.reachable} frames ahead, windows of {self.dataset.length} frames "
                f"with {self.given} shown ask for {horizons}; give --data.length {self.given + self.reachable} or less"
            )
        if self.needs.future_pose and stage == "predict" and self.dataset.predict != "test":
            raise UserError(
                f"{type(self).__name__} reads the ego's true motion, which windows without targets do not have; give "
                "--data.predict test, or another forecaster"
            )
        if stage == "fit":
            self.clock.resume(None)
            self._limit_epochs()
            if self.hparams.get("init_from") and not self.trainer.ckpt_path:
                self.initialise(str(self.hparams["init_from"]))
                if not self.trainer.fast_dev_run:  # type: ignore[attr-defined]
                    self.trainer.num_sanity_val_steps = math.inf  # what they are worth before training
        if self.trained is not None:
            check_grids(
                self.trained["data"], self.dataset.grids(), self.needs.context, self.dataset.store, what=self.origin
            )
        self.static = HorizonMSE(horizons).to(self.device)
        chosen = MetricCollection({"mse": HorizonMSE(horizons)})
        if stage == "test":
            chosen = forecast_metrics(horizons, extra=self.extra_metrics)
        self.scores = chosen.to(self.device)

    def _limit_epochs(self) -> None:
        """The schedule is the model's; --trainer.max_epochs can only cut it short."""
        if self.epochs is not None:
            limit = self.trainer.max_epochs
            self.trainer.fit_loop.max_epochs = self.epochs if limit in (None, -1) else min(int(limit or 0), self.epochs)

    def forecast_checked(self, seen: Seen, horizons: int) -> Forecast:
        """The forecast, which must be what was asked for.

        Raises:
            UserError: if it has other horizons, or other cells than what is seen.
        """
        return as_asked(type(self).__name__, self.forecast(seen, horizons), seen, horizons)

    def see(self, mapper: Mapper, mapped: Sequence[Mapped]) -> Seen:
        """What this forecaster sees of the newest of the frames `mapped` by `mapper`, as a batch of one window.

        Raises:
            UserError: if there are fewer frames than it is shown, or it needs what the mapper does not make.
        """
        if len(mapped) < self.given:
            raise UserError(f"{len(mapped)} frames mapped, {type(self).__name__} sees {self.given}; map more first")
        seen = seen_of(mapper, mapped[-self.given :], self.view, self.needs)
        return cast(Seen, self.transfer_batch_to_device(seen, self.device, 0))

    def work(self, batch: WindowBatch) -> int | None:
        """Floating-point operations of the forecast of a `batch` (a multiply-add is two).

        Those of convolutions and matrix products, counted as they run; None where nothing is learned.
        """
        if self.is_fixed:
            return None
        with torch.no_grad(), FlopCounterMode(display=False) as counter:
            self.forecast(batch["seen"], self.dataset.horizons)
        return int(counter.get_total_flops())

    def batch_of(self, part: str, index: int) -> WindowBatch:
        """A batch of one window of the data module's `part`, on this model's device."""
        batch = collate([self.dataset.datasets[part][index]])
        return cast(WindowBatch, self.transfer_batch_to_device(batch, self.device, 0))

    def score(self, batch: WindowBatch, forecast: Forecast) -> None:
        """Count a batch's forecast, and the last frame shown as the static baseline's."""
        future, last = batch["future"], batch["seen"]["occupancy"][:, -1]
        assert future is not None  # only prediction goes without
        target = future["occupancy"]
        check_forecast(type(self).__name__, batch, forecast.probability)
        wanted = any(isinstance(metric, WindowMetric) and metric.needs_cells for metric in self.scores.values())
        kinds = kinds_of(batch) if wanted else {}
        told = {"samples": forecast.samples, "label": future["label"], "mass": future["occupied_mass"], **kinds}
        self.scores.update(forecast.probability, target, last, batch["index"], **told)
        self.static.update(last[:, None].expand_as(target), target, last, batch["index"])

    def scored(self) -> dict[str, Any]:
        """Every metric over all windows counted, which are then forgotten; `static_mse` is the static baseline's."""
        found = self.scores.compute() | {"static_mse": self.static.compute()}
        check_metrics(dict(self.scores.items()), found)
        self.scores.reset()
        self.static.reset()
        return found

    def validation_step(self, batch: WindowBatch, batch_index: int) -> None:
        self.score(batch, self.forecast_checked(batch["seen"], self.dataset.horizons))

    def on_validation_epoch_end(self) -> None:
        self.validated = found = self.scored()
        mse, static = found["mse"], found["static_mse"]
        self.log_error("val/mse", mse, prog_bar=True)
        self.log_error("static/mse", static)
        self.log("val/skill", (1 - mse.mean.mean() / static.mean.mean()).float())

    def log_error(self, name: str, error: PerHorizon, prog_bar: bool = False) -> None:
        """Log the mean of an error over the horizons as `name`, and each shown horizon's as `name`_<horizon>."""
        self.log(name, error.mean.mean().float(), prog_bar=prog_bar)
        for step, horizon in self._shown():
            self.log(f"{name}_{horizon}", error.mean[step - 1].float())

    def test_step(self, batch: WindowBatch, batch_index: int) -> None:
        start = time.perf_counter()
        forecast = self.forecast_checked(batch["seen"], self.dataset.horizons)
        if forecast.probability.is_cuda:
            torch.cuda.synchronize()
        self.forecast_seconds += time.perf_counter() - start
        self.forecast_windows += len(forecast.probability)  # of this process, as the seconds are
        self.score(batch, forecast)

    def on_test_epoch_start(self) -> None:
        self.forecast_seconds, self.forecast_windows = 0.0, 0

    def on_test_epoch_end(self) -> None:
        self.tested = found = self.scored()
        for step, name in self._shown():
            self.log(f"test/mse_{name}", found["mse"].mean[step - 1].float())
            self.log(f"test/skill_{name}", found["skill"].value[step - 1].float())

    def _shown(self) -> list[tuple[int, str]]:
        """The horizons that are logged one by one, as steps, and their names."""
        period = self.dataset.period
        return [(step, horizon_name(step, period)) for step in shown_steps(self.dataset.horizons, period)]

    def predict_step(self, batch: WindowBatch, batch_index: int) -> Mapping[str, Any]:
        """The forecast (B, horizons, H, W) of a batch, and which windows it belongs to."""
        forecast = self.forecast_checked(batch["seen"], self.dataset.horizons).probability
        check_forecast(type(self).__name__, batch, forecast)
        return {
            "forecast": forecast,
            "drive": batch["drive"],
            "start": batch["start"],
            "index": batch["index"],
        }

    def initialise(self, source: str) -> None:
        """Take the weights that training starts from: those that ship under a name, of a folder alike, of a checkpoint.

        Raises:
            UserError: if there are none, or they belong to another forecaster, variant or kind of grids.
        """
        file = Path(source)
        if file.is_file() or file.suffix == ".ckpt":
            self.take(read_checkpoint(file, self.device), "the checkpoint")
        else:
            self.take_weights(Weights.read(found(source, "--model.init_from")))
        rank_zero_info(f"weights: {source}")

    def take_weights(self, weights: Weights) -> None:
        """Take weights that ship, or lie in a folder alike; otherwise as `take`."""
        self.take(weights.checkpoint, weights.title)

    def take(self, checkpoint: Mapping[str, Any], origin: str) -> None:
        """Take a checkpoint's weights, which messages call those of its `origin`.

        Raises:
            UserError: if they belong to another forecaster or variant; to other grids, as soon as these are known.
        """
        check_origin(checkpoint, self, origin)
        self.load_state_dict(dict(checkpoint["state_dict"]))
        self.trained, self.origin = checkpoint.get("trained"), origin

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        checkpoint["forecaster"] = type(self).__name__
        checkpoint["class_path"] = f"{type(self).__module__}.{type(self).__qualname__}"
        checkpoint["trained"] = self.trained = training(self)

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Refuse a checkpoint whose weights belong to another forecaster, variant or kind of grids.

        Raises:
            UserError: naming what differs.
        """
        self.trained = checkpoint.get("trained")
        self.clock.resume(self.trained)
        if getattr(self, "_trainer", None) is not None:
            trust_no_path(checkpoint, self.trainer)
            if self.trained is not None:
                check_grids(self.trained["data"], self.dataset.grids(), self.needs.context, self.dataset.store)
            check_loops(checkpoint, self.trainer)
        check_origin(checkpoint, self, "the checkpoint")
