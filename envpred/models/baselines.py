"""Forecasters without parameters, for comparison; they run through the same `validate` and `test`."""

from abc import abstractmethod

import torch
from torch import Tensor

from envpred.datamodules import WindowBatch
from envpred.errors import UserError
from envpred.mapping.ego_motion import extrapolate
from envpred.mapping.particle_forecast import HORIZONS
from envpred.models.forecaster import Forecaster


class LastFrame(Forecaster):
    """The static baseline: the last frame shown stands for every horizon."""

    def __init__(self, variant: str = "dst_static", given: int = 5) -> None:
        super().__init__(variant, given)
        self.save_hyperparameters()

    def forecast(self, batch: WindowBatch, given: int = 5, horizons: int | None = None) -> Tensor:
        last = batch["occupancy"][:, given - 1 : given]
        return last.expand(-1, _horizons(batch, given, horizons), -1, -1)


class ParticleForecast(Forecaster):
    """The particle filter's forecast: moving particles carried on by the linear model (the paper's third baseline)."""

    extra = "particle_forecast"

    def __init__(self, variant: str = "dst_static", given: int = 5) -> None:
        super().__init__(variant, given)
        self.save_hyperparameters()

    def setup(self, stage: str) -> None:
        super().setup(stage)
        horizons = self.dataset.length - self.dataset.given
        if horizons > HORIZONS:
            raise UserError(
                f"particle forecasts reach {HORIZONS} frames, windows ask for {horizons}; give "
                f"--data.length {self.dataset.given + HORIZONS} or less"
            )

    def forecast(self, batch: WindowBatch, given: int = 5, horizons: int | None = None) -> Tensor:
        return batch["extra"][:, : _horizons(batch, given, horizons)].float() / 255


class _Moved(Forecaster):
    """The last frame shown, moved by whole cells into each future grid; entering cells get the training mean.

    Grids share a lattice, so where a future grid will lie is exact once the ego's future position is known.

    Args:
        variant: input variant; the probability that is judged is the same for all.
        given: frames shown.
        fill: probability of entering cells; by default the mean over the training windows.
    """

    def __init__(self, variant: str = "dst_static", given: int = 5, fill: float | None = None) -> None:
        super().__init__(variant, given)
        self.save_hyperparameters()
        self.fill = 0.5 if fill is None else fill

    @abstractmethod
    def centres(self, batch: WindowBatch, given: int, horizons: int) -> Tensor:
        """Lattice cells (B, horizons, 2) at the centres of the future grids."""

    def setup(self, stage: str) -> None:
        super().setup(stage)
        if self.hparams["fill"] is None:
            self.fill = self.dataset.training_mean()

    def forecast(self, batch: WindowBatch, given: int = 5, horizons: int | None = None) -> Tensor:
        last = batch["occupancy"][:, given - 1]
        centres = self.centres(batch, given, _horizons(batch, given, horizons))
        shift = centres - batch["centre_cell"][:, given - 1 : given]
        return torch.stack([_move(grid, moves, self.fill) for grid, moves in zip(last, shift, strict=True)])


class MovedLastFrame(_Moved):
    """Moved by the ego's constant speed and turn rate over the frames shown: what the ego's own motion explains."""

    def centres(self, batch: WindowBatch, given: int, horizons: int) -> Tensor:
        future = extrapolate(batch["pose"][:, :given].double(), horizons)
        return torch.floor(future[..., :2] + 0.5).to(batch["centre_cell"].dtype)


class MovedLastFrameOracle(_Moved):
    """Moved by the ego's true motion, which no forecaster knows: what perfect odometry would explain."""

    def setup(self, stage: str) -> None:
        if stage == "predict" and self.dataset.predict != "test":
            raise UserError(
                "the oracle reads the ego's true motion, which windows without targets do not have; give "
                "--data.predict test, or --config configs/model/moved_last_frame.yaml"
            )
        super().setup(stage)

    def centres(self, batch: WindowBatch, given: int, horizons: int) -> Tensor:
        return batch["centre_cell"][:, given : given + horizons]


def _horizons(batch: WindowBatch, given: int, horizons: int | None) -> int:
    """Forecasts asked for, by default one for each frame of the batch after those shown."""
    return batch["occupancy"].shape[1] - given if horizons is None else horizons


def _move(grid: Tensor, shifts: Tensor, fill: float) -> Tensor:
    """`grid` (H, W) as grids (N, H, W) see it whose centre cells lie `shifts` (N, 2) further."""
    H, W = grid.shape
    i = torch.arange(H, device=grid.device) + shifts[:, :1]
    j = torch.arange(W, device=grid.device) + shifts[:, 1:]
    inside = ((i >= 0) & (i < H))[:, :, None] & ((j >= 0) & (j < W))[:, None, :]
    return torch.where(inside, grid[i.clamp(0, H - 1)[:, :, None], j.clamp(0, W - 1)[:, None, :]], fill)
