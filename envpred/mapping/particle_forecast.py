"""The particle forecast: moving particles carried on by the linear model (third baseline of Itkina et al. 2019)."""

from collections.abc import Sequence

import torch
from torch import Tensor

from envpred.mapping.geometry import GridSpec
from envpred.mapping.particle_state import ParticleFilterParameters, ParticleState
from envpred.mapping.particles.cells import cell_number, without_rim

SECONDS = 1.5  # how far ahead the particle forecast is stored
HORIZONS = 15  # the frames that are, at 10 Hz


def horizons_at(period: float) -> int:
    """Frames of `period` seconds that reach 1.5 s ahead."""
    return max(round(SECONDS / period), 1)


def forecast(
    state: ParticleState,
    moving: Tensor,
    parameters: ParticleFilterParameters,
    grid: GridSpec,
    generator: torch.Generator,
    horizons: int = HORIZONS,
    drift: Sequence[float] = (0.0, 0.0),
) -> Tensor:
    """Probability of occupied (horizons, H, W) 1 ... `horizons` frames ahead: the sum of weights per cell, at most 1.

    Velocities relative to the ego put the forecast into the ego's grid of that future frame; velocities relative to the
    ground leave it in the grid of the present frame, because the filter knows nothing of the ego's future, unless
    `drift` says how the grid will move.

    Args:
        state: the particles after the present frame.
        moving: (H, W) bool, cells whose particles take part.
        parameters: numbers of the filter.
        grid: cells and resolution.
        generator: source of randomness, on the state's device.
        horizons: how many frames ahead.
        drift: (2,) assumed velocity of the grid relative to the particles' frame, in m/s.
    """
    outside = torch.nn.functional.pad(moving, (1, 1, 1, 1)).flatten()
    taking_part = outside.index_select(0, cell_number(state.position, grid.cells).int()).nonzero().squeeze(1)
    position = state.position.index_select(1, taking_part)
    velocity = state.velocity.index_select(1, taking_part) - state.velocity.new_tensor(drift)[:, None]
    # A horizon's cell sums depend on the particles' positions at that horizon alone, so one draw serves all horizons,
    # stretched to the standard deviation that the noise has added up to by then.
    noise = torch.randn(position.shape, generator=generator, device=position.device)
    ahead = []
    for h in range(1, horizons + 1):
        moved = position.add(velocity, alpha=h * parameters.period / grid.resolution)
        moved.add_(noise, alpha=position_deviation(h, parameters) / grid.resolution)
        count = torch.bincount(cell_number(moved, grid.cells), minlength=(grid.cells + 2) ** 2)
        ahead.append((without_rim(count, grid.cells) * state.weight).clamp(max=1))
    return torch.stack(ahead)


def position_deviation(h: int, parameters: ParticleFilterParameters) -> float:
    """Standard deviation (metres, per axis) of a position after `h` steps of the linear model.

    Position noise comes in h times; the velocity noise of step m carries over into h - m later positions, and
    1 + 4 + ... + (h-1)^2 = (h-1) h (2h-1) / 6.
    """
    velocity_part = (parameters.period * parameters.velocity_noise) ** 2 * (h - 1) * h * (2 * h - 1) / 6
    return float((h * parameters.position_noise**2 + velocity_part) ** 0.5)
