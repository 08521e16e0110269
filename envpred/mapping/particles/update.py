"""Update: masses by Dempster's rule, what of them is newly born, and weights by measured velocities."""

import torch
from torch import Tensor

from envpred.mapping.matching import Matches
from envpred.mapping.particle_state import ParticleFilterParameters
from envpred.mapping.particles.cells import Particles, with_rim
from envpred.mapping.particles.resample import apportion, select

UNMATCHED = 1e-3  # likelihood, beside 1 of the best, of a velocity that does not agree at all


def combine(occupied: Tensor, free: Tensor, measured: Tensor) -> Tensor:
    """Dempster's rule (63): masses (2, H, W) from predicted `occupied` and `free` (H, W) and `measured` (2, H, W)."""
    unknown, unknown_measured = 1 - occupied - free, 1 - measured[0] - measured[1]
    conflict = free * measured[0] + occupied * measured[1]
    agreed_occupied = occupied * unknown_measured + unknown * measured[0] + occupied * measured[0]
    agreed_free = free * unknown_measured + unknown * measured[1] + free * measured[1]
    return torch.stack((agreed_occupied, agreed_free)) / (1 - conflict)


def split_occupied(
    occupied: Tensor, occupied_predicted: Tensor, parameters: ParticleFilterParameters
) -> tuple[Tensor, Tensor]:
    """Posterior m(O) split into what is newly born, rho_b (67), and what has persisted, rho_p (68)."""
    birth = parameters.birth * (1 - occupied_predicted)
    born = occupied * (birth / (occupied_predicted + birth))
    return born, occupied - born


def weigh(
    particles: Particles, matches: Matches, parameters: ParticleFilterParameters, generator: torch.Generator
) -> None:
    """Draw the particles of each cell anew in proportion to the likelihood of their velocity (69)-(73), in place.

    Nuss et al. keep these weights until resampling; drawn within the cells, they leave the mass of every cell as it is
    and particles that all weigh the same.

    Args:
        particles: the persistent particles; their order is changed.
        matches: measurement of velocities.
        parameters: `matching_sharpness` counts.
        generator: source of randomness.
    """
    tile = with_rim(matches.tile, -1)
    measured = (tile >= 0).nonzero().squeeze(1)
    count = particles.count.index_select(0, measured)
    cell = torch.repeat_interleave(count)  # which of the measured cells each of their particles is in
    if not len(cell):
        return
    first = particles.count.cumsum(0).index_select(0, measured) - count.cumsum(0)
    place = torch.arange(len(cell), device=cell.device) + first.index_select(0, cell)
    order = particles.order.index_select(0, place)
    surface = tile.index_select(0, measured).index_select(0, cell)
    agreement = matches.log_likelihood(select(particles.velocity, order), surface)
    likelihood = agreement.mul_(parameters.matching_sharpness).exp_().double().add_(UNMATCHED)
    total = likelihood.new_zeros(len(measured)).index_add_(0, cell, likelihood)
    share = likelihood.mul_((count / total).index_select(0, cell))
    parent = torch.repeat_interleave(apportion(share, len(cell), generator), output_size=len(cell))
    particles.order[place] = order.index_select(0, parent)
