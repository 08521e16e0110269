"""Particle filters for tests: small ones, random measurements, and a moving block."""

import torch

from envpred.mapping.geometry import GridSpec
from envpred.mapping.particle_state import ParticleFilterParameters, ParticleState, initial_state
from envpred.mapping.particles import DogmaGrid, step
from envpred.mapping.particles.cells import Particles

PAPER = ParticleFilterParameters()
SMALL = ParticleFilterParameters(persistent=300, births=40)
TINY = GridSpec(cells=8)
NOWHERE = torch.zeros(0, dtype=torch.int64)
NOBODY = Particles(torch.zeros(2, 0), torch.zeros(2, 0), NOWHERE, torch.zeros(100, dtype=torch.int64))


def seeded(seed: int = 0, device: str = "cpu") -> torch.Generator:
    return torch.Generator(device).manual_seed(seed)


def masses(occupied: torch.Tensor, free: float = 0.95) -> torch.Tensor:
    """Measurement (2, H, W): `occupied` cells 0.95 occupied, the others `free`."""
    return torch.stack((0.95 * occupied, free * (1 - occupied)))


def random_masses(seed: int, cells: int) -> torch.Tensor:
    """Measurement of which a third is occupied, a third free, a third unknown."""
    kind = torch.randint(3, (cells, cells), generator=seeded(seed))
    return 0.95 * torch.stack((kind == 1, kind == 2)).float()


def follow(
    grids: list[torch.Tensor],
    shift: tuple[int, int] = (0, 0),
    parameters: ParticleFilterParameters = SMALL,
    grid: GridSpec = TINY,
    seed: int = 0,
    device: str = "cpu",
) -> list[tuple[ParticleState, DogmaGrid]]:
    """States and dynamic grids of a sequence of measurements."""
    state, generator, out = initial_state(parameters, grid, device), seeded(seed, device), []
    for measured in grids:
        state, dogma = step(state, measured.to(device), shift, parameters, grid, generator)
        out.append((state, dogma))
    return out


def block_scene(
    grid: GridSpec,
    frames: int,
    velocity: tuple[float, float],
    ego_cells: tuple[int, int] = (0, 0),
    length: float = 4.0,
) -> tuple[list[torch.Tensor], torch.Tensor]:
    """A block of `length` x 2 m in free space, moving relative to the ground, on a grid that moves by `ego_cells`.

    Returns the measurements and the cells that the block covers in the last frame.
    """
    centre = (torch.arange(grid.cells) - grid.half) * grid.resolution
    grids = []
    for t in range(frames):
        where = [
            centre - offset - v * PAPER.period * (t - frames + 1) + step_cells * grid.resolution * (t - frames + 1)
            for offset, v, step_cells in zip((3.0, -2.0), velocity, ego_cells, strict=True)
        ]
        block = (where[0].abs()[:, None] <= length / 2) & (where[1].abs()[None, :] <= 1)
        grids.append(masses(block.float()))
    return grids, block
