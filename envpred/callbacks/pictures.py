"""What a run shows besides its scalars: pictures of fixed windows."""

import io
from dataclasses import dataclass, replace

import numpy as np
import PIL.Image
import torch
from lightning.pytorch import Callback, LightningModule, Trainer
from lightning.pytorch.loggers import TensorBoardLogger
from lightning.pytorch.trainer.states import TrainerFn
from matplotlib.figure import Figure
from numpy.typing import NDArray
from tensorboard.compat.proto.summary_pb2 import Summary
from torch import Tensor

from envpred.callbacks.loggers import tensorboard
from envpred.callbacks.results import result_writer
from envpred.datamodules import Forecast, WindowBatch
from envpred.errors import UserError
from envpred.mapping.dogma import VELOCITY_SCALE
from envpred.models import Forecaster, RolloutForecaster
from envpred.pictures.animations import scene_animation
from envpred.pictures.forecasts import forecast_strip, scene_strip
from envpred.pictures.grids import save
from envpred.pictures.rollouts import rollout_strip
from envpred.pictures.velocities import velocity_strip
from envpred.results.scenes import Scene, write_scenes

DRAWN = "drawn.npz"  # the forecasts of the windows that are drawn, beside the result
FORECAST = "forecast"

Velocities = tuple[NDArray[np.float32], NDArray[np.float32]]  # probability of occupied, and velocity in m/s


@dataclass(frozen=True)
class Drawn:
    """A window that is drawn: how pictures show it, what the forecaster saw, and what it said."""

    scene: Scene
    batch: WindowBatch
    forecast: Forecast


class Pictures(Callback):
    """Targets, forecasts and errors of fixed windows: in TensorBoard, and after a test beside the result, too.

    TensorBoard also has the first window beside the last frame shown, with the ego and what moves circled.

    Args:
        windows: how many windows are drawn, spread evenly over those there are; 0 for none.
        every_n_epochs: how often in training; 0 for never.

    Raises:
        UserError: if one of them is negative.
    """

    def __init__(self, windows: int = 2, every_n_epochs: int = 1) -> None:
        for name, value in (("windows", windows), ("every_n_epochs", every_n_epochs)):
            if value < 0:
                raise UserError(f"--pictures.{name} {value}: give 0 for no pictures, or more")
        self.windows, self.every_n_epochs = windows, every_n_epochs

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        logger = tensorboard(trainer)
        if logger is None or trainer.sanity_checking or not isinstance(pl_module, Forecaster):
            return
        if trainer.state.fn == TrainerFn.FITTING and not self._is_due(trainer.current_epoch):
            return
        step = trainer.global_step
        for place, drawn in enumerate(self._drawn(pl_module, "val").values()):
            scene = drawn.scene
            title = f"{scene.where}, epoch {trainer.current_epoch}"
            logger.experiment.add_figure(f"window_{place}/forecast", forecast_strip(scene, title), step)
            for kind, picture in _more(pl_module, drawn, title).items():
                logger.experiment.add_figure(f"window_{place}/{kind}", picture, step)
            if place == 0:
                beside = replace(scene, forecasts=scene.forecasts | {"last frame": scene.static})
                logger.experiment.add_figure("window_0/comparison", scene_strip(beside, title=title), step)
                _show(logger, "window_0/animation", scene_animation(beside), step)

    def on_test_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Pictures of the same kind beside the result, and the forecasts themselves for a report's pictures."""
        writer, logger = result_writer(trainer), tensorboard(trainer)
        if trainer.fast_dev_run or not self.windows or writer is None or not trainer.is_global_zero:  # type: ignore[attr-defined]
            return
        if not isinstance(pl_module, Forecaster):
            return
        folder = writer.write(trainer, pl_module).parent  # what was measured is safe before anything is drawn
        names: dict[str, str] = {}
        found = self._drawn(pl_module, "test")
        for place, drawn in enumerate(found.values()):
            pictures = {"errors": forecast_strip(drawn.scene)} | _more(pl_module, drawn)
            files = {kind: f"pictures/window_{place}_{kind}.png" for kind in pictures}
            for kind, picture in pictures.items():
                save(picture, folder / files[kind])
            files["animation"] = f"pictures/window_{place}.gif"
            save(scene_animation(drawn.scene), folder / files["animation"])
            for kind, file in files.items():
                names[f"window_{place}_{kind}"] = file
                if logger is not None:
                    _show(logger, f"test_window_{place}/{kind}", (folder / file).read_bytes(), trainer.global_step)
        write_scenes(folder / DRAWN, {index: drawn.scene for index, drawn in found.items()})
        writer.add_pictures(trainer, pl_module, names, DRAWN)

    def _is_due(self, epoch: int) -> bool:
        """Whether pictures are drawn after this epoch of training."""
        return self.every_n_epochs > 0 and epoch % self.every_n_epochs == 0

    def _drawn(self, model: Forecaster, part: str) -> dict[int, Drawn]:
        """The fixed windows of `part` with the model's forecast, by their place among all."""
        data = model.dataset.datasets[part]
        indices = np.unique(np.linspace(0, len(data) - 1, self.windows).round().astype(int)).tolist()
        return {index: _forecast(model, part, index) for index in indices}


def _show(logger: TensorBoardLogger, tag: str, picture: bytes, step: int) -> None:
    """Show the content of a .png or .gif as it is; TensorBoard's own writer takes pixels alone, and animates none."""
    width, height = PIL.Image.open(io.BytesIO(picture)).size
    image = Summary.Image(height=height, width=width, colorspace=3, encoded_image_string=picture)
    logger.experiment._get_file_writer().add_summary(Summary(value=[Summary.Value(tag=tag, image=image)]), step)


def _forecast(model: Forecaster, part: str, index: int) -> Drawn:
    """Window `index` of `part` with its forecast."""
    batch, place = model.batch_of(part, index), model.dataset.datasets[part].places[index]
    seen, future = batch["seen"], batch["future"]
    assert future is not None  # validation and test have targets
    with torch.no_grad():
        forecast = model.forecast_checked(seen, model.dataset.horizons)
    context = model.view.probability(seen["context"])[0, -1].cpu().numpy() if "context" in seen else None
    stride, first, given = model.dataset.stride, place.start, model.given
    scene = Scene(
        drive=place.drive.name,
        frames=tuple(place.drive.frames[first : first + given * stride : stride]),
        seen=seen["occupancy"][0].cpu().numpy(),
        target=future["occupancy"][0].cpu().numpy(),
        centre_cell=torch.cat([seen["centre_cell"][0], future["centre_cell"][0]]).cpu().numpy(),
        forecasts={FORECAST: forecast.probability[0].float().cpu().numpy()},
        resolution=model.dataset.grid.resolution,
        period=model.dataset.period,
        context=context,
        oracles=frozenset({FORECAST} if model.role == "oracle" else ()),
    )
    return Drawn(scene, batch, forecast)


def _more(model: Forecaster, drawn: Drawn, title: str = "") -> dict[str, Figure]:
    """Pictures of a window that only some forecasters have, by their kind."""
    pictures = {"velocity": _velocities(model, drawn, title), "rollout": _parts(model, drawn, title)}
    return {kind: picture for kind, picture in pictures.items() if picture is not None}


def _parts(model: Forecaster, drawn: Drawn, title: str = "") -> Figure | None:
    """What the forecast of a window is made of; None of a forecaster that rolls out no world."""
    if not isinstance(model, RolloutForecaster):
        return None
    with torch.no_grad():
        found = model.parts(drawn.batch["seen"], model.dataset.horizons)
    world, rendered = (part[0].float().cpu().numpy() for part in found[:2])
    corrected = None if found.corrected is None else found.corrected[0].float().cpu().numpy()
    return rollout_strip(drawn.scene, world, rendered, corrected, title or None)


def _velocities(model: Forecaster, drawn: Drawn, title: str = "") -> Figure | None:
    """Velocities of a window, shown, to come and, of a forecaster of all channels, forecast.

    None if the model's variant has no velocities.
    """
    pair, future = model.view.velocity, drawn.batch["future"]
    if pair is None or future is None:
        return None

    def of(channels: Tensor) -> Velocities:
        probability, velocity = model.view.probability(channels), VELOCITY_SCALE * channels[..., list(pair), :, :]
        return probability.float().cpu().numpy(), velocity.float().cpu().numpy()

    channels = drawn.forecast.channels
    return velocity_strip(
        of(drawn.batch["seen"]["frames"][0, -1]),
        of(future["frames"][0]),
        None if channels is None else of(channels[0]),
        drawn.scene.resolution,
        drawn.scene.period,
        title or drawn.scene.where,
    )
