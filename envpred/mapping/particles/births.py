"""New particles."""

import torch
from torch import Tensor

from envpred.mapping.particle_state import ParticleFilterParameters
from envpred.mapping.particles.cells import Particles, with_rim
from envpred.mapping.particles.random import normal
from envpred.mapping.particles.resample import apportion


def give_birth(born: Tensor, parameters: ParticleFilterParameters, generator: torch.Generator) -> Particles:
    """New particles (74)-(80): cells get them in proportion to `born` (H, W), anywhere in the cell, at any velocity."""
    N, width = parameters.births, born.shape[1] + 2
    share = with_rim(born).double()
    count = apportion(torch.where(share.sum() > 0, share, 1), N, generator)
    cell = torch.repeat_interleave(count, output_size=N).int()
    position = torch.stack((torch.div(cell, width, rounding_mode="floor"), cell % width)) - 1
    position = position + torch.rand(position.shape, generator=generator, device=born.device)
    velocity = normal(N, generator) * parameters.birth_velocity
    velocity *= torch.rand(N, generator=generator, device=born.device) >= parameters.birth_standing
    return Particles(position, velocity, torch.arange(N, device=born.device), count)
