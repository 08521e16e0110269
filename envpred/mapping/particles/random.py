"""Normal numbers for many particles at little cost."""

from functools import cache

import torch
from torch import Tensor


def normal(count: int, generator: torch.Generator) -> Tensor:
    """Standard normal numbers (2, count), on the generator's device, to be read only.

    A stretch of a fixed table from a random place on: to draw every number anew is what a filter on a CPU would spend
    most of its time on.  The numbers of one particle, and those of the particles of one cell, are independent of each
    other all the same.
    """
    table = normal_table(max(2**20, 4 * count), generator.device)
    start = int(torch.randint(len(table) - 2 * count, (), generator=generator, device=generator.device))
    return table[start : start + 2 * count].view(2, count)


@cache
def normal_table(size: int, device: torch.device) -> Tensor:
    """Independent standard normal numbers (size,), the same ones on every device."""
    with torch.inference_mode(mode=False):
        return torch.randn(size, generator=torch.Generator().manual_seed(0)).to(device)
