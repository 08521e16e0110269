"""Resampling: systematic, in proportion to the masses of the cells."""

import torch
from torch import Tensor

from envpred.mapping.particles.cells import Particles, with_rim


def resample(
    persistent: Particles, persisting: Tensor, newborn: Particles, born: Tensor, generator: torch.Generator
) -> tuple[Tensor, Tensor, Tensor]:
    """Positions and velocities (2, N) drawn from persistent and newborn particles, and the weight () that each has.

    Systematic sampling in the order of the cells: each cell gets children in proportion to its mass, to within one,
    evenly from its particles.
    """
    N, births = persistent.velocity.shape[1], newborn.velocity.shape[1]
    count = torch.cat((persistent.count, newborn.count))
    mass = torch.cat((with_rim(persisting), with_rim(born))).double()
    total = torch.where(count > 0, mass, 0).sum()  # what no particle carries cannot be drawn
    share = torch.where(total > 0, mass / count.clamp(min=1), 1)
    children = apportion(torch.repeat_interleave(share, count, output_size=N + births), N, generator)
    parent = torch.repeat_interleave(children, output_size=N)
    parent = torch.cat((persistent.order, newborn.order + N)).index_select(0, parent)
    position = select(torch.cat((persistent.position, newborn.position), 1), parent)
    velocity = select(torch.cat((persistent.velocity, newborn.velocity), 1), parent)
    return position, velocity, (total / N).float()


def apportion(share: Tensor, total: int, generator: torch.Generator) -> Tensor:
    """How many (M,) int64 of `total` each of M parties gets, in proportion to `share` (M,) float64, systematically."""
    u = torch.rand((), generator=generator, device=share.device, dtype=torch.float64)
    reached = share.cumsum(0)
    reached.mul_(total / reached[-1]).add_(u)
    counts = reached.int().clamp_(max=total)  # rounding may reach beyond the total
    counts[-1] = total
    return counts.diff(prepend=counts.new_zeros(1))


def select(rows: Tensor, index: Tensor) -> Tensor:
    """`rows[:, index]` (2, N), row by row, which a CPU does faster."""
    out = rows.new_empty(len(rows), len(index))
    for row, into in zip(rows, out, strict=True):
        torch.index_select(row, 0, index, out=into)
    return out
