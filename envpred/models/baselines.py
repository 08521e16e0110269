"""Forecasters without parameters, for comparison; they run through the same `validate` and `test`."""

from abc import abstractmethod
from typing import ClassVar

import torch
from torch import Tensor

from envpred.datamodules import Forecast, Needs, Role, Seen
from envpred.mapping.dogma import is_moving
from envpred.mapping.ego_motion import extrapolate
from envpred.mapping.shift import shifted_tensor
from envpred.models.forecaster import Forecaster


class LastFrame(Forecaster):
    """The static baseline: the last frame shown stands for every horizon."""

    role = "static"

    def __init__(self, variant: str = "dst_static", given: int = 5) -> None:
        super().__init__(variant, given)
        self.save_hyperparameters()

    def forecast(self, seen: Seen, horizons: int) -> Forecast:
        return Forecast(seen["occupancy"][:, -1:].expand(-1, horizons, -1, -1))


class ParticleForecast(Forecaster):
    """The particle filter's forecast: moving particles carried on by the linear model (the paper's third baseline)."""

    needs = Needs(arrays=("particle_forecast",))
    role = "particle"

    def __init__(self, variant: str = "dst_static", given: int = 5) -> None:
        super().__init__(variant, given)
        self.save_hyperparameters()

    @property
    def reachable(self) -> int:
        return self.dataset.shape_of("particle_forecast")[0]  # as many as the store keeps

    def forecast(self, seen: Seen, horizons: int) -> Forecast:
        return Forecast(_particles(seen, horizons))


def _particles(seen: Seen, horizons: int) -> Tensor:
    """The particle filter's forecast (B, horizons, H, W) of the last frame shown."""
    return seen["arrays"]["particle_forecast"][:, -1, :horizons].float() / 255


class _Moved(Forecaster):
    """The last frame shown, moved by whole cells into each future grid; entering cells get a mean.

    Grids share a lattice, so where a future grid will lie is exact once the ego's future position is known.

    Args:
        variant: input variant; the probability that is judged is the same for all.
        given: frames shown.
        fill: probability of entering cells; by default the mean over the training windows or, where no drive trains,
            over the frames shown of each window.
    """

    def __init__(self, variant: str = "dst_static", given: int = 5, fill: float | None = None) -> None:
        super().__init__(variant, given)
        self.save_hyperparameters()
        self.fill = fill

    @abstractmethod
    def centres(self, seen: Seen, horizons: int) -> Tensor:
        """Lattice cells (B, horizons, 2) at the centres of the future grids."""

    def setup(self, stage: str) -> None:
        super().setup(stage)
        if self.hparams["fill"] is None and self.dataset.selected.get("train"):
            self.fill = self.dataset.training_mean()
        self.hparams["filled_with"] = "frames shown" if self.fill is None else self.fill  # for the result to say

    def last(self, seen: Seen) -> Tensor:
        """What is moved: the probability (B, H, W) of the last frame shown."""
        return seen["occupancy"][:, -1]

    def forecast(self, seen: Seen, horizons: int) -> Forecast:
        shift = self.centres(seen, horizons) - seen["centre_cell"][:, -1:]
        last = self.last(seen)
        fill = seen["occupancy"].mean((1, 2, 3)) if self.fill is None else last.new_full((len(last),), self.fill)
        moved = [
            torch.stack([shifted_tensor(grid, by, float(value)) for by in shifts])
            for grid, shifts, value in zip(last, shift.tolist(), fill, strict=True)
        ]
        return Forecast(torch.stack(moved))


class MovedLastFrame(_Moved):
    """Moved by the ego's constant speed and turn rate over the frames shown: what the ego's own motion explains."""

    role: ClassVar[Role] = "moved"

    def centres(self, seen: Seen, horizons: int) -> Tensor:
        future = extrapolate(seen["pose"].double(), horizons)
        return torch.floor(future[..., :2] + 0.5).to(seen["centre_cell"].dtype)


class MovedParticles(MovedLastFrame):
    """What stands is moved by the ego's motion, what moves is carried on by the particle filter.

    The particle forecast alone knows nothing of what stands, and is judged as if that were free.  Here cells that the
    filter finds to move are taken out of the last frame, whose rest is moved as `MovedLastFrame` does, and the particle
    forecast is put over it.  That lies in the ego's future grids, whatever velocities are relative to: where that is
    the ground, the filter takes the ego to go on as it did.
    """

    needs = Needs(arrays=("particle_forecast", "velocity", "velocity_cov"))
    role = "particle"

    @property
    def reachable(self) -> int:
        return self.dataset.shape_of("particle_forecast")[0]

    def last(self, seen: Seen) -> Tensor:
        velocity, covariance = (seen["arrays"][name][:, -1].float() for name in ("velocity", "velocity_cov"))
        return super().last(seen).masked_fill(is_moving(velocity, covariance), 0)

    def forecast(self, seen: Seen, horizons: int) -> Forecast:
        stands = super().forecast(seen, horizons).probability
        return Forecast(torch.maximum(stands, _particles(seen, horizons)))


class MovedLastFrameOracle(_Moved):
    """Moved by the ego's true motion, which no forecaster knows: what perfect odometry would explain."""

    needs = Needs(future_pose=True)
    role = "oracle"

    def centres(self, seen: Seen, horizons: int) -> Tensor:
        return seen["future_centre_cell"][:, :horizons]
