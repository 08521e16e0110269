"""What a run shows besides its scalars: pictures of fixed windows, and the static baseline's line."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lightning.pytorch import Callback, LightningModule, Trainer
from lightning.pytorch.loggers import TensorBoardLogger
from matplotlib.figure import Figure
from numpy.typing import NDArray
from tensorboard.compat.proto.summary_pb2 import Summary
from torch.utils.data import default_collate
from torch.utils.tensorboard import SummaryWriter

from envpred import plots
from envpred.models.forecaster import SHOWN_HORIZONS, Forecaster
from envpred.results import RESULT, add_pictures
from envpred.velocity_pictures import of_window

Occupancy = NDArray[np.float32]


class Pictures(Callback):
    """Targets, forecasts and errors of fixed windows: in TensorBoard after validation, beside the result after a test.

    Args:
        windows: how many windows are drawn, spread evenly over those there are.
        every_n_epochs: how often in training.
    """

    def __init__(self, windows: int = 2, every_n_epochs: int = 1) -> None:
        self.windows, self.every_n_epochs = windows, every_n_epochs
        self.static: SummaryWriter | None = None

    def on_fit_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        logger = _tensorboard(trainer)
        if logger is not None:
            # The tab needs the names of the final metrics before there are any.
            logger.log_hyperparams(_flat(dict(pl_module.hparams)), {"final/val_mse": float("nan")})

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        logger = _tensorboard(trainer)
        if logger is None or trainer.sanity_checking or not isinstance(pl_module, Forecaster):
            return
        self._draw_reference(trainer, logger)
        if trainer.current_epoch % self.every_n_epochs:
            return
        for place, (occupancy, forecast, where, velocity) in enumerate(self._windows(pl_module, "val")):
            title = f"{where}, epoch {trainer.current_epoch}"
            strip = plots.forecast_strip(occupancy[pl_module.given :], forecast, SHOWN_HORIZONS, title)
            logger.experiment.add_figure(f"window_{place}/forecast", strip, trainer.global_step)
            if velocity is not None:
                logger.experiment.add_figure(f"window_{place}/velocity", velocity, trainer.global_step)
            if place == 0:
                self._animate(logger, occupancy, forecast, pl_module.given, trainer.global_step)

    def on_test_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Pictures of the same kind beside the result."""
        folder = trainer.log_dir
        if folder is None or not trainer.is_global_zero or not isinstance(pl_module, Forecaster):
            return
        names: dict[str, str] = {}
        for place, (occupancy, forecast, where, velocity) in enumerate(self._windows(pl_module, "test")):
            strip = plots.forecast_strip(occupancy[pl_module.given :], forecast, SHOWN_HORIZONS, where)
            plots.save(strip, Path(folder) / "pictures" / f"window_{place}.png")
            gif = plots.animation(occupancy, forecast, pl_module.given)
            (Path(folder) / "pictures" / f"window_{place}.gif").write_bytes(gif)
            names |= {f"window_{place}_{kind}": f"pictures/window_{place}.{kind}" for kind in ("png", "gif")}
            if velocity is not None:
                plots.save(velocity, Path(folder) / "pictures" / f"window_{place}_velocity.png")
        add_pictures(Path(folder) / RESULT, names)

    def _windows(self, model: Forecaster, part: str) -> Iterator[tuple[Occupancy, Occupancy, str, Figure | None]]:
        """Occupancy (T, H, W), forecast (T - given, H, W), whereabouts and velocities of fixed windows of `part`."""
        data = model.dataset.datasets[part]
        for index in np.unique(np.linspace(0, len(data) - 1, self.windows).round().astype(int)):
            batch = default_collate([data[int(index)]])
            moved = model.transfer_batch_to_device(batch, model.device, 0)
            with torch.no_grad():
                forecast = model.forecast(moved, model.given)[0].float().cpu().numpy()
            where = f"{batch['drive'][0]}, frames from {int(batch['start'][0])}"
            yield batch["occupancy"][0].numpy(), forecast, where, of_window(model, moved, where)

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
    def _animate(logger: TensorBoardLogger, target: Any, forecast: Any, given: int, step: int) -> None:
        gif = plots.animation(target, forecast, given)
        height, width = 2 * target.shape[2], 4 * target.shape[1]
        image = Summary.Image(height=height, width=width, colorspace=3, encoded_image_string=gif)
        summary = Summary(value=[Summary.Value(tag="window_0/animation", image=image)])
        logger.experiment._get_file_writer().add_summary(summary, step)


def _tensorboard(trainer: Trainer) -> TensorBoardLogger | None:
    """The TensorBoard logger of the process that writes."""
    if not trainer.is_global_zero:
        return None
    return next((logger for logger in trainer.loggers if isinstance(logger, TensorBoardLogger)), None)


def _flat(values: Mapping[str, Any]) -> dict[str, Any]:
    """Values that the HPARAMS tab can show; lists as text."""
    return {k: v if isinstance(v, int | float | str | bool) else str(v) for k, v in values.items()}
