"""Particles on the grid: which cell each is in, and all of them in the order of their cells.

They are counted on the grid with a rim one cell wide, which collects those that have left.
"""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import pad


@dataclass(frozen=True)
class Particles:
    """Particles in the order of their cells.

    They are not moved in memory: particle k has `position[:, order[k]]` and `velocity[:, order[k]]`.

    Args:
        position: (2, M) in cells.
        velocity: (2, M) in m/s.
        order: (N,) int64.
        count: ((H+2)(W+2),) int64, how many particles each cell of the grid with its rim holds.
    """

    position: Tensor
    velocity: Tensor
    order: Tensor
    count: Tensor


def sort_by_cell(position: Tensor, velocity: Tensor, cells: int) -> Particles:
    """The particles at `position` with `velocity` (2, N) in the order of the cells they are in."""
    number = cell_number(position, cells)
    order = torch.sort(number, stable=True).indices
    count = torch.bincount(number, minlength=(cells + 2) ** 2)
    return Particles(position, velocity, order, count)


def cell_number(position: Tensor, cells: int) -> Tensor:
    """Number (N,) of the cell of each `position` (2, N), in the grid with its rim."""
    small = (cells + 2) ** 2 < 2**15  # short keys sort faster
    i, j = (position + 1).clamp_(0, cells + 1).to(torch.int16 if small else torch.int32)
    number: Tensor = i.mul_(cells + 2).add_(j)
    return number


def with_rim(field: Tensor, fill: int = 0) -> Tensor:
    """`field` (H, W) with a rim of `fill`, flat."""
    return pad(field, (1, 1, 1, 1), value=fill).flatten()


def without_rim(flat: Tensor, cells: int) -> Tensor:
    """The grid (H, W) in a `flat` one with its rim."""
    return flat.view(cells + 2, cells + 2)[1:-1, 1:-1]
