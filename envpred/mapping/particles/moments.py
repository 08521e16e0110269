"""Statistical moments: mean velocity and covariance of the particles of each cell."""

import torch
from torch import Tensor
from torch.nn.functional import embedding_bag, pad

from envpred.mapping.particles.cells import Particles, without_rim


def moments(particles: Particles, cells: int) -> tuple[Tensor, Tensor]:
    """Mean velocity (2, H, W) and covariance (3, H, W) of the particles of each cell, which weigh the same."""
    x, y = particles.velocity
    first = particles.count.cumsum(0) - particles.count
    table = x.new_empty(len(x), 5)
    for column, values in enumerate((x, y, x * x, x * y, y * y)):  # on one thread, stacking takes twice as long
        table[:, column] = values
    # Sums over the particles of one cell at a time: few enough for single precision.
    sums = embedding_bag(particles.order, table, first, mode="sum")
    x, y, xx, xy, yy = (without_rim(mean, cells) for mean in (sums / particles.count.clamp(min=1)[:, None]).T)
    covariance = torch.stack(((xx - x * x).clamp_(min=0), xy - x * y, (yy - y * y).clamp_(min=0)))
    return torch.stack((x, y)), covariance


def over_neighbours(velocity: Tensor, covariance: Tensor, weight: Tensor, cells: int) -> tuple[Tensor, Tensor]:
    """Mean velocity (2, H, W) and covariance (3, H, W) of the particles within `cells` of each cell, itself included.

    Args:
        velocity: (2, H, W) means of the single cells.
        covariance: (3, H, W) covariances of the single cells.
        weight: (H, W) what the particles of each cell weigh together.
        cells: how far, along either axis.
    """
    mixed = covariance + outer(velocity)  # second moments add up, covariances do not
    sums = torch.cat((velocity, mixed, torch.ones_like(weight)[None])) * weight
    sums = box_sum(sums, cells)
    holds = (covariance[0] > 0) | (velocity[0] != 0)  # cells without particles stay without a velocity
    sums = sums[:5] / sums[5].clamp(min=1e-6) * holds
    mean = sums[:2]
    spread = sums[2:] - outer(mean)
    return mean, torch.stack((spread[0].clamp(min=0), spread[1], spread[2].clamp(min=0)))


def box_sum(fields: Tensor, cells: int) -> Tensor:
    """Sums of `fields` (C, H, W) over the square of cells within `cells` of each; cells outside the grid are 0."""
    for axis in (1, 2):
        length = fields.shape[axis]
        padded = pad(fields, (0, 0, cells, cells) if axis == 1 else (cells, cells))
        fields = padded.narrow(axis, 0, length).clone()
        for k in range(1, 2 * cells + 1):
            fields.add_(padded.narrow(axis, k, length))
    return fields


def outer(velocity: Tensor) -> Tensor:
    """Products (xx, xy, yy) of the components of `velocity` (2, H, W)."""
    x, y = velocity
    return torch.stack((x * x, x * y, y * y))
