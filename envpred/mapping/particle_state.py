"""What the particle filter carries from frame to frame, and the numbers it runs with (Nuss et al. 2016)."""

from dataclasses import dataclass, replace
from typing import Literal

import torch
from torch import Tensor

from envpred.errors import UserError
from envpred.mapping.geometry import GridSpec


@dataclass(frozen=True)
class ParticleFilterParameters:
    """Numbers of the PHD/MIB filter; the defaults are those of Itkina et al. 2019.

    The probability p_A that a measurement belongs to a particle is no parameter: a laser grid measures no velocity, all
    particles of a cell are equally likely, and then p_A drops out of equations (69) to (80); where velocities are
    measured by matching, it is 1.

    Args:
        persistent: particles that are kept from frame to frame.
        births: particles that are born in a frame.
        discount: factor alpha on the free mass of the past, per frame.
        period: time T between the frames that the numbers per frame hold for, in seconds; see `at`.
        survival: probability p_S that what occupies a cell is still there one frame later.
        birth: probability p_B that a cell is newly occupied.
        birth_velocity: standard deviation of a newborn's velocity, per axis, in m/s.
        birth_standing: share of the newborns that start with velocity 0 instead (the paper has none).
        position_noise: standard deviation of the process noise on the position, per axis and frame, in metres.
        velocity_noise: standard deviation of the process noise on the velocity, per axis and frame, in m/s.
        matching: how many frames ago the grid is that velocities are measured by, see `matching`; 0 for none (as the
            paper).
        matching_fastest: fastest velocity that is tried, per axis, in m/s; the cost grows with its square.
        matching_sharpness: log-likelihood of a velocity per cell that agrees.
        matching_gain: how many cells more than by standing still must agree for something to have moved.
        neighbourhood: a cell's velocity is that of the particles within so many cells (the paper: its own alone).
        frame: what velocities are relative to.  "ego" (Itkina et al.): particles stay in the local grid and do not
            follow its shift, so a standing object moves with the negative velocity of the ego, in jumps of whole cells.
            "ground": particles follow the shift of the grid, so a standing object has velocity 0.  Cells that enter the
            grid then have no prior: what is found there is newly born.
    """

    persistent: int = 200_000
    births: int = 20_000
    discount: float = 0.9
    period: float = 0.1
    survival: float = 0.99
    birth: float = 0.02
    birth_velocity: float = 4.0
    birth_standing: float = 0.0
    position_noise: float = 0.02
    velocity_noise: float = 0.8
    matching: int = 0
    matching_fastest: float = 15.0
    matching_sharpness: float = 0.1
    matching_gain: float = 15.0
    neighbourhood: int = 0
    frame: Literal["ego", "ground"] = "ego"

    def __post_init__(self) -> None:
        for name in ("persistent", "births"):
            if getattr(self, name) < 1:
                raise UserError(f"the particle filter needs at least one particle: {name} is {getattr(self, name)}")
        for name in ("discount", "survival", "birth"):
            if not 0 < getattr(self, name) < 1:
                raise UserError(f"{name} of the particle filter must lie between 0 and 1, not {getattr(self, name)}")
        if not 0 <= self.birth_standing <= 1:
            raise UserError(f"birth_standing of the particle filter must lie in 0 ... 1, not {self.birth_standing}")
        for name in (
            "birth_velocity",
            "position_noise",
            "velocity_noise",
            "matching",
            "matching_fastest",
            "matching_sharpness",
            "matching_gain",
            "neighbourhood",
        ):
            if not getattr(self, name) >= 0:
                raise UserError(f"{name} of the particle filter must not be negative, not {getattr(self, name)}")
        if not self.period > 0:
            raise UserError(f"period of the particle filter must be positive, not {self.period} s")
        if self.matching and self.frame == "ego":
            raise UserError(
                "matching of the particle filter needs cells that stay where they are, and those of the ego's frame "
                "shift; give --particles.filter.frame ground"
            )
        if self.frame not in ("ego", "ground"):
            raise UserError(f"frame of the particle filter must be 'ego' or 'ground', not {self.frame!r}")

    def at(self, period: float) -> "ParticleFilterParameters":
        """These numbers for frames that lie `period` seconds apart instead of `self.period`.

        With r the ratio of the two: what stays from frame to frame, the discount and p_S, becomes x^r; what comes anew,
        p_B, becomes 1 - (1 - p_B)^r; the process noise is a random walk, whose deviation per frame becomes sqrt(r) of
        what it was; matching looks back over the same time.  Numbers of particles and velocities stay.
        """
        r = period / self.period
        if r == 1:  # to the bit
            return self
        return replace(
            self,
            period=period,
            discount=self.discount**r,
            survival=self.survival**r,
            birth=1 - (1 - self.birth) ** r,
            position_noise=self.position_noise * r**0.5,
            velocity_noise=self.velocity_noise * r**0.5,
            matching=max(round(self.matching / r), 1) if self.matching else 0,
        )


# For velocities relative to the ground, where most things stand and the others drive steadily.  The paper's process
# noise (8 m/s^2) lets a particle forget its velocity within few frames; its narrow births pull fast objects towards 0;
# slowly fading mass spends particles on places long out of sight.  A long wall says nothing about a velocity along it,
# so some newborns that stand decide for what is likelier.  Velocities are measured by matching, because cells inside a
# vehicle learn its velocity too slowly from what survives, and averaged over one metre.
GROUND = ParticleFilterParameters(
    survival=0.9,
    birth=0.005,
    birth_velocity=6.0,
    birth_standing=0.05,
    velocity_noise=0.5,
    matching=3,
    neighbourhood=1,
    frame="ground",
)


@dataclass(frozen=True)
class ParticleState:
    """The particles and masses after a frame; every particle weighs the same, because they have been resampled.

    Args:
        position: (2, N) in cells from the local grid's south-west corner: cell (i, j) spans [i, i+1) x [j, j+1).
        velocity: (2, N) in m/s, relative to what `ParticleFilterParameters.frame` says.
        weight: () the occupied mass that one particle stands for.
        mass: (2, H, W) posterior masses (occupied, free).
        seen: (K, H, W) measured m(O) - m(F) of the last K frames, the oldest first, on the present grid; K is
            `ParticleFilterParameters.matching`.
    """

    position: Tensor
    velocity: Tensor
    weight: Tensor
    mass: Tensor
    seen: Tensor


def initial_state(
    parameters: ParticleFilterParameters, grid: GridSpec, device: torch.device | str = "cpu"
) -> ParticleState:
    """The state before the first frame: nothing is known, and the particles weigh nothing."""
    return ParticleState(
        position=torch.zeros(2, parameters.persistent, device=device),
        velocity=torch.zeros(2, parameters.persistent, device=device),
        weight=torch.zeros((), device=device),
        mass=torch.zeros(2, grid.cells, grid.cells, device=device),
        seen=torch.zeros(parameters.matching, grid.cells, grid.cells, device=device),
    )
