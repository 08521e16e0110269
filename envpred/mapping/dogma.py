"""Dynamic occupancy grid maps of a drive: which cells move, how fast, what goes into the store (Itkina et al. 2019)."""

from collections import deque
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from envpred.errors import check_number
from envpred.mapping.geometry import FloatArray, GridSpec, IntArray
from envpred.mapping.particle_forecast import forecast, horizons_at
from envpred.mapping.particle_state import ParticleFilterParameters, initial_state
from envpred.mapping.particles import DogmaGrid, step
from envpred.mapping.period import PERIOD

# The speed (m/s, per axis) that a network sees as 1: two cars that meet at 36 km/h each, relative to one of them, or
# one car at 72 km/h relative to the ground.  What is faster is clipped.
VELOCITY_SCALE = 20.0
EGO_SECONDS = 0.5  # how long the ego's velocity is averaged over


@dataclass(frozen=True)
class DogmaParameters:
    """How dynamic grids are made; the defaults are those of Itkina et al. 2019.

    Args:
        filter: numbers of the particle filter.
        tau: a cell moves if the squared Mahalanobis distance of its velocity from 0 exceeds this.
        occupied: a cell has a velocity only if its m(O) exceeds this.
    """

    filter: ParticleFilterParameters = field(default_factory=ParticleFilterParameters)
    tau: float = 4.0
    occupied: float = 0.95

    def __post_init__(self) -> None:
        check_number("particles.tau", self.tau)
        check_number("particles.occupied", self.occupied, 0, 1)


@dataclass(frozen=True)
class Dogma:
    """The dynamic grids of a drive, or of one frame without the axis T, as the store keeps them.

    Args:
        velocity: (T, 2, H, W) float16 mean velocity (east, north) in m/s; 0 where m(O) is too low.
        covariance: (T, 3, H, W) float16 its covariance (xx, xy, yy) in m^2/s^2; 0 where m(O) is too low.
        forecast: (T, N, H, W) uint8 probability of occupied 1 ... N frames ahead, times 255, or None; N frames
            are 1.5 s.
    """

    velocity: NDArray[np.float16]
    covariance: NDArray[np.float16]
    forecast: NDArray[np.uint8] | None


class VelocityFilter:
    """The particle filter at work on one grid after the other; what it has seen is kept inside.

    Args:
        parameters: filter and thresholds.
        grid: cells and resolution.
        period: time between frames in seconds.
        seed: of all randomness; the filter starts anew with it after a gap.
        with_forecast: also make the particle forecast, the largest array.
        device: where the filter runs.
    """

    def __init__(
        self,
        parameters: DogmaParameters,
        grid: GridSpec,
        period: float = PERIOD,
        seed: int = 0,
        with_forecast: bool = False,
        device: torch.device | str = "cpu",
    ) -> None:
        self.parameters, self.grid, self.seed, self.device = parameters, grid, seed, device
        self.filter = parameters.filter.at(period)
        self.horizons = horizons_at(period) if with_forecast else 0
        self.reset()

    def reset(self) -> None:
        """Forget what was seen, as after a gap."""
        self.generator = torch.Generator(self.device).manual_seed(self.seed)
        self.state = initial_state(self.filter, self.grid, self.device)
        frames = max(round(EGO_SECONDS / self.filter.period), 1)
        self._seen: deque[tuple[IntArray, FloatArray]] = deque(maxlen=frames + 1)

    @torch.inference_mode()
    def step(self, measured: NDArray[np.float32], centre_cell: IntArray, position: FloatArray | None = None) -> Dogma:
        """The dynamic grid after one more measurement grid.

        Args:
            measured: (2, H, W) measurement masses (occupied, free), see `evidence.measured`.
            centre_cell: (2,) lattice cell at the grid's centre; only differences matter.
            position: (2,) of the ego in metres, for the drift of forecasts relative to the ground; by default that of
                the centre cell.

        Raises:
            ValueError: if the shapes do not belong together or `measured` holds no masses.
        """
        centre_cell = np.asarray(centre_cell)
        shift = centre_cell - (self._seen[-1][0] if self._seen else centre_cell)
        place = centre_cell * self.grid.resolution if position is None else position
        self._seen.append((centre_cell, np.asarray(place, np.float64)))
        masses = torch.from_numpy(np.ascontiguousarray(measured)).to(self.device)
        self.state, dogma = step(self.state, masses, shift.tolist(), self.filter, self.grid, self.generator)
        dogma = confident(dogma, self.parameters)
        return Dogma(
            dogma.velocity.cpu().numpy().astype(np.float16),
            dogma.covariance.cpu().numpy().astype(np.float16),
            self._forecast(dogma) if self.horizons else None,
        )

    def _forecast(self, dogma: DogmaGrid) -> NDArray[np.uint8]:
        moving = is_moving(dogma.velocity, dogma.covariance, self.parameters.tau)
        drift = self._drift() if self.filter.frame == "ground" else (0.0, 0.0)
        ahead = forecast(self.state, moving, self.filter, self.grid, self.generator, self.horizons, drift)
        return to_byte(ahead).cpu().numpy()

    def _drift(self) -> tuple[float, float]:
        """Mean velocity (m/s) of the ego, and so of its grid, over the last half second; 0 at the start."""
        steps = len(self._seen) - 1
        if not steps:
            return 0.0, 0.0
        east, north = (self._seen[-1][1] - self._seen[0][1]) / (steps * self.filter.period)
        return float(east), float(north)


def run(
    measured: NDArray[np.float32],
    centre_cell: NDArray[np.integer],
    parameters: DogmaParameters | None = None,
    grid: GridSpec | None = None,
    seed: int = 0,
    with_forecast: bool = False,
    device: torch.device | str = "cpu",
    period: float = PERIOD,
) -> Dogma:
    """The dynamic grids of a whole drive.

    Args:
        measured: (T, 2, H, W) measurement masses (occupied, free), see `evidence.measured`.
        centre_cell: (T, 2) lattice cell at each grid's centre; only differences matter.
        parameters: filter and thresholds.
        grid: cells and resolution.
        seed: seed of all randomness.
        with_forecast: also make the particle forecast, the largest array.
        device: where the filter runs.
        period: time between frames in seconds.

    Raises:
        ValueError: if the shapes do not belong together or `measured` holds no masses.
    """
    parameters, grid = parameters or DogmaParameters(), grid or GridSpec()
    if measured.ndim != 4 or centre_cell.shape != (len(measured), 2):
        raise ValueError(
            f"measured (T,2,H,W) and centre_cell (T,2) expected, not {measured.shape} and {centre_cell.shape}"
        )
    velocities = VelocityFilter(parameters, grid, period, seed, with_forecast, device)
    frames = [velocities.step(seen, centre) for seen, centre in zip(measured, centre_cell, strict=True)]
    ahead = np.stack([f.forecast for f in frames if f.forecast is not None]) if with_forecast else None
    return Dogma(np.stack([f.velocity for f in frames]), np.stack([f.covariance for f in frames]), ahead)


def confident(dogma: DogmaGrid, parameters: DogmaParameters) -> DogmaGrid:
    """`dogma` with velocity and covariance 0 in the cells whose m(O) is too low."""
    known = dogma.mass[0] > parameters.occupied
    return DogmaGrid(dogma.mass, dogma.velocity * known, dogma.covariance * known)


def mahalanobis(velocity: Tensor, covariance: Tensor) -> Tensor:
    """Squared Mahalanobis distance (..., H, W) of `velocity` (..., 2, H, W) from 0: v' P^-1 v.

    A degenerate `covariance` (..., 3, H, W), |det P| < 1e-6, counts as distance 0.
    """
    (x, y), (xx, xy, yy) = velocity.float().unbind(-3), covariance.float().unbind(-3)
    determinant = xx * yy - xy * xy
    degenerate = determinant.abs() < 1e-6
    distance = (yy * x * x - 2 * xy * x * y + xx * y * y) / torch.where(degenerate, 1, determinant)
    return torch.where(degenerate, 0, distance)


def is_moving(velocity: Tensor, covariance: Tensor, tau: float = DogmaParameters.tau) -> Tensor:
    """Which cells (..., H, W) bool move, from `velocity` (..., 2, H, W) and `covariance` (..., 3, H, W)."""
    return mahalanobis(velocity, covariance) > tau


def moving_velocity(velocity: Tensor, covariance: Tensor, tau: float = DogmaParameters.tau) -> Tensor:
    """`velocity` (..., 2, H, W) float32 in m/s, 0 in the cells that do not move."""
    return velocity.float() * is_moving(velocity, covariance, tau).unsqueeze(-3)


def scaled(velocity: Tensor, scale: float = VELOCITY_SCALE) -> Tensor:
    """`velocity` in m/s as a network sees it: divided by `scale` (m/s) and clipped to [-1, 1]."""
    return (velocity / scale).clamp(-1, 1)


def to_byte(probability: Tensor) -> Tensor:
    """Probabilities in [0, 1] as uint8, times 255."""
    return (probability * 255).round().to(torch.uint8)
