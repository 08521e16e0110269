"""Prediction: particles move on with constant velocity and process noise; masses age."""

from collections.abc import Sequence

import torch
from torch import Tensor

from envpred.mapping.geometry import GridSpec
from envpred.mapping.particle_state import ParticleFilterParameters, ParticleState
from envpred.mapping.particles.random import normal


def predict(
    state: ParticleState,
    shift: Sequence[int],
    parameters: ParticleFilterParameters,
    grid: GridSpec,
    generator: torch.Generator,
) -> tuple[Tensor, Tensor]:
    """Positions and velocities (2, N) one period later, with constant velocity and process noise (14)."""
    N = state.position.shape[1]
    position = state.position.add(state.velocity, alpha=parameters.period / grid.resolution)
    position.add_(normal(N, generator), alpha=parameters.position_noise / grid.resolution)
    if parameters.frame == "ground":
        position.sub_(position.new_tensor(shift)[:, None])
    return position, state.velocity.add(normal(N, generator), alpha=parameters.velocity_noise)


def predict_occupied(count: Tensor, weight: Tensor, parameters: ParticleFilterParameters) -> Tensor:
    """Predicted m(O): the sum of a cell's weights, each times p_S (39), capped at p_S."""
    return (count * (weight * parameters.survival)).clamp(max=parameters.survival)


def predict_free(free: Tensor, occupied_predicted: Tensor, parameters: ParticleFilterParameters) -> Tensor:
    """Predicted m(F): the aged free mass, as far as the predicted m(O) leaves room (62)."""
    return torch.minimum(parameters.discount * free, 1 - occupied_predicted)
