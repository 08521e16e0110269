"""One step of the filter: its stages in their order."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from envpred.mapping.geometry import GridSpec
from envpred.mapping.matching import match
from envpred.mapping.particle_state import ParticleFilterParameters, ParticleState
from envpred.mapping.particles.births import give_birth
from envpred.mapping.particles.cells import sort_by_cell, without_rim
from envpred.mapping.particles.moments import moments, over_neighbours
from envpred.mapping.particles.predict import predict, predict_free, predict_occupied
from envpred.mapping.particles.resample import resample
from envpred.mapping.particles.update import combine, split_occupied, weigh
from envpred.mapping.shift import shifted_tensor


@dataclass(frozen=True)
class DogmaGrid:
    """A dynamic occupancy grid.

    Args:
        mass: (2, H, W) posterior masses (occupied, free).
        velocity: (2, H, W) mean velocity (east, north) of a cell's persistent particles in m/s, 0 where there are none.
        covariance: (3, H, W) their covariance (xx, xy, yy) in m^2/s^2, 0 where there are none.
    """

    mass: Tensor
    velocity: Tensor
    covariance: Tensor


def step(
    state: ParticleState,
    measured: Tensor,
    shift: Sequence[int],
    parameters: ParticleFilterParameters,
    grid: GridSpec,
    generator: torch.Generator,
) -> tuple[ParticleState, DogmaGrid]:
    """The state and the dynamic grid after one more measurement grid.

    Args:
        state: the state after the frame before, or `initial_state`.
        measured: (2, H, W) float32 measurement masses (occupied, free).
        shift: (2,) how far the grid has moved since the frame before, in cells.
        parameters: numbers of the filter.
        grid: the grid, for its resolution.
        generator: source of randomness, on the state's device.

    Raises:
        ValueError: if the shapes do not belong together or `measured` holds no masses (NaN, negative, sum > 1).
    """
    check(state, measured, shift, parameters, grid)
    persistent = sort_by_cell(*predict(state, shift, parameters, grid, generator), grid.cells)

    occupied_predicted = predict_occupied(without_rim(persistent.count, grid.cells), state.weight, parameters)
    if parameters.frame == "ground":
        # Particles from beyond the border are missing, so what has crept into the cells that enter is no prediction.
        occupied_predicted = occupied_predicted * shifted_tensor(torch.ones_like(occupied_predicted), shift)
    free = shifted_tensor(state.mass[1], shift)
    mass = combine(occupied_predicted, predict_free(free, occupied_predicted, parameters), measured)
    born, persisting = split_occupied(mass[0], occupied_predicted, parameters)

    seen = state.seen
    if parameters.matching:
        now, seen = measured[0] - measured[1], shifted_tensor(seen, shift)
        weigh(persistent, match(now, seen[0], parameters, grid), parameters, generator)
        seen = torch.cat((seen[1:], now[None]))
    newborn = give_birth(born, parameters, generator)
    # (69)-(73) without a velocity measurement: the particles of a cell share rho_p equally; likewise (74)-(80) rho_b.
    # Hence nothing is stored per particle: a cell's mass and count say what each of its particles weighs.
    velocity, covariance = moments(persistent, grid.cells)
    if parameters.neighbourhood:
        velocity, covariance = over_neighbours(velocity, covariance, persisting, parameters.neighbourhood)
    position, speed, weight = resample(persistent, persisting, newborn, born, generator)
    return (
        ParticleState(position, speed, weight, mass, seen),
        DogmaGrid(mass, velocity, covariance),
    )


def check(
    state: ParticleState,
    measured: Tensor,
    shift: Sequence[int],
    parameters: ParticleFilterParameters,
    grid: GridSpec,
) -> None:
    """Refuse what does not belong together."""
    if measured.shape != state.mass.shape or measured.shape != (2, grid.cells, grid.cells) or len(shift) != 2:
        raise ValueError(
            f"measured masses (2,{grid.cells},{grid.cells}) like the state's and a shift (2,) expected, "
            f"not {tuple(measured.shape)}, {tuple(state.mass.shape)} and ({len(shift)},)"
        )
    if state.position.shape != (2, parameters.persistent) or state.velocity.shape != state.position.shape:
        raise ValueError(
            f"positions and velocities (2,{parameters.persistent}) expected, "
            f"not {tuple(state.position.shape)} and {tuple(state.velocity.shape)}"
        )
    if state.seen.shape != (parameters.matching, *measured.shape[1:]):
        raise ValueError(
            f"{parameters.matching} grids seen before expected for matching, not {tuple(state.seen.shape)}"
        )
    # Comparisons with "not a number" are false, so this finds it as well.
    if not bool((measured >= 0).all() & (measured.sum(0) <= 1 + 1e-6).all()):
        raise ValueError("measured masses must be numbers of at least 0 that sum to at most 1 in every cell")
