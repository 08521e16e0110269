"""What a run shows besides its scalars: pictures of fixed windows, and the static baseline's line."""

import io
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import PIL.Image
import torch
from lightning.pytorch import Callback, LightningModule, Trainer
from lightning.pytorch.loggers import TensorBoardLogger
from matplotlib.figure import Figure
from tensorboard.compat.proto.summary_pb2 import Summary
from torch import Tensor
from torch.utils.data import default_collate
from torch.utils.tensorboard import SummaryWriter

from envpred.datamodules import WindowBatch
from envpred.horizons import PERIOD
from envpred.mapping.dogma import VELOCITY_SCALE
from envpred.models.forecaster import Forecaster
from envpred.pictures import grids as pictures
from envpred.pictures.animations import scene_animation
from envpred.pictures.forecasts import forecast_strip, scene_strip
from envpred.pictures.velocities import Moving, velocity_strip
from envpred.results.result import RESULT, add_pictures
from envpred.results.scenes import Scene, write_scenes

DRAWN = "drawn.npz"  # the forecasts of the windows that are drawn, beside the result
FORECAST = "forecast"
TRAINING_DATA = ("split", "length", "samples", "batch_size", "augment", "crop", "seed")  # what HPARAMS shows of it


class Pictures(Callback):
    """Targets, forecasts and errors of fixed windows: in TensorBoard after validation, beside the result after a test.

    TensorBoard also has the first window beside the last frame shown, with the ego and what moves circled.

    Args:
        windows: how many windows are drawn, spread evenly over those there are.
        every_n_epochs: how often in training.
    """

    def __init__(self, windows: int = 2, every_n_epochs: int = 1) -> None:
        self.windows, self.every_n_epochs = windows, every_n_epochs
        self.static: SummaryWriter | None = None

    def on_fit_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        logger = _tensorboard(trainer)
        if logger is not None and isinstance(pl_module, Forecaster):
            data = {f"data.{name}": getattr(pl_module.dataset, name) for name in TRAINING_DATA}
            # The tab needs the names of the final metrics before there are any.
            logger.log_hyperparams(_flat(dict(pl_module.hparams) | data), {"final/val_mse": float("nan")})

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        logger = _tensorboard(trainer)
        if logger is None or trainer.sanity_checking or not isinstance(pl_module, Forecaster):
            return
        self._draw_reference(trainer, logger)
        if trainer.current_epoch % self.every_n_epochs:
            return
        step = trainer.global_step
        for place, (index, scene) in enumerate(self._scenes(pl_module, "val").items()):
            title = f"{scene.where}, epoch {trainer.current_epoch}"
            logger.experiment.add_figure(f"window_{place}/forecast", forecast_strip(scene, title), step)
            velocities = _velocities(pl_module, _batch(pl_module, "val", index), scene, title)
            if velocities is not None:
                logger.experiment.add_figure(f"window_{place}/velocity", velocities, step)
            if place == 0:
                beside = replace(scene, forecasts=scene.forecasts | {"last frame": scene.static})
                logger.experiment.add_figure("window_0/comparison", scene_strip(beside, title=title), step)
                self._animate(logger, scene_animation(beside), step)

    def on_test_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Pictures of the same kind beside the result, and the forecasts themselves for a report's pictures."""
        folder = trainer.log_dir
        if folder is None or not trainer.is_global_zero or not isinstance(pl_module, Forecaster):
            return
        names: dict[str, str] = {}
        scenes = self._scenes(pl_module, "test")
        for place, (index, scene) in enumerate(scenes.items()):
            pictures.save(forecast_strip(scene), Path(folder) / "pictures" / f"window_{place}.png")
            (Path(folder) / "pictures" / f"window_{place}.gif").write_bytes(scene_animation(scene))
            names |= {f"window_{place}_errors": f"pictures/window_{place}.png"}
            names |= {f"window_{place}_animation": f"pictures/window_{place}.gif"}
            velocities = _velocities(pl_module, _batch(pl_module, "test", index), scene, scene.where)
            if velocities is not None:
                pictures.save(velocities, Path(folder) / "pictures" / f"window_{place}_velocity.png")
                names |= {f"window_{place}_velocity": f"pictures/window_{place}_velocity.png"}
        write_scenes(Path(folder) / DRAWN, scenes)
        add_pictures(Path(folder) / RESULT, names, DRAWN)

    def _scenes(self, model: Forecaster, part: str) -> dict[int, Scene]:
        """The fixed windows of `part` with the model's forecast, by their place among all."""
        data = model.dataset.datasets[part]
        scenes = {}
        for index in np.unique(np.linspace(0, len(data) - 1, self.windows).round().astype(int)).tolist():
            place, batch = data.places[index], _batch(model, part, index)
            with torch.no_grad():
                forecast = model.forecast(batch, model.given)[0].float().cpu().numpy()
            occupancy = batch["occupancy"][0].cpu().numpy()
            scenes[index] = Scene(
                place.drive.name,
                tuple(place.drive.frames[place.start : place.start + model.given]),
                occupancy[: model.given],
                occupancy[model.given :],
                batch["centre_cell"][0].cpu().numpy(),
                {FORECAST: forecast},
                place.drive.manifest["lattice"]["resolution"],
                place.drive.manifest.get("period", PERIOD),
                oracles=frozenset({FORECAST} if model.role == "oracle" else ()),
            )
        return scenes

    def on_train_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        logger = _tensorboard(trainer)
        if logger is not None and "val/mse" in trainer.callback_metrics:
            logger.log_metrics({"final/val_mse": float(trainer.callback_metrics["val/mse"])}, trainer.global_step)

    def teardown(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        if self.static is not None:
            self.static.close()
            self.static = None

    def _draw_reference(self, trainer: Trainer, logger: TensorBoardLogger) -> None:
        """The static baseline under the same names as a run of its own, so that both share a chart."""
        if self.static is None:
            self.static = SummaryWriter(f"{logger.log_dir}/static_baseline")
        for name, value in trainer.callback_metrics.items():
            if name.startswith("static/"):
                self.static.add_scalar(name.replace("static/", "val/"), float(value), trainer.global_step)

    @staticmethod
    def _animate(logger: TensorBoardLogger, gif: bytes, step: int) -> None:
        width, height = PIL.Image.open(io.BytesIO(gif)).size
        image = Summary.Image(height=height, width=width, colorspace=3, encoded_image_string=gif)
        summary = Summary(value=[Summary.Value(tag="window_0/animation", image=image)])
        logger.experiment._get_file_writer().add_summary(summary, step)


def _batch(model: Forecaster, part: str, index: int) -> WindowBatch:
    """A batch of one window of `part`, on the model's device."""
    batch = default_collate([model.dataset.datasets[part][index]])
    return cast(WindowBatch, model.transfer_batch_to_device(batch, model.device, 0))


def _velocities(model: Forecaster, batch: WindowBatch, scene: Scene, title: str) -> Figure | None:
    """The velocities of a `scene` and, of a forecaster of all channels, those it forecasts; None without velocities."""
    channels = model.view.velocity
    if channels is None:
        return None

    def moving(frames: Tensor) -> Moving:
        probability, velocity = model.view.probability(frames), VELOCITY_SCALE * frames[..., list(channels), :, :]
        return probability.float().cpu().numpy(), velocity.float().cpu().numpy()

    forecast = None
    forecast_frames = getattr(model, "forecast_frames", None)
    if forecast_frames is not None:
        with torch.no_grad():
            forecast = moving(forecast_frames(batch, model.given)[0])
    frames, now = batch["frames"][0], model.given
    return velocity_strip(
        moving(frames[now - 1]), moving(frames[now:]), forecast, scene.resolution, scene.period, title
    )


def _tensorboard(trainer: Trainer) -> TensorBoardLogger | None:
    """The TensorBoard logger of the process that writes."""
    if not trainer.is_global_zero:
        return None
    return next((logger for logger in trainer.loggers if isinstance(logger, TensorBoardLogger)), None)


def _flat(values: Mapping[str, Any]) -> dict[str, Any]:
    """Values that the HPARAMS tab can show; lists as text."""
    return {k: v if isinstance(v, int | float | str | bool) else str(v) for k, v in values.items()}
