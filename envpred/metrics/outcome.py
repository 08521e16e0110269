"""What happened in a cell, as it was measured in that very frame: occupied, free, or not measured."""

import torch
from torch import Tensor

from envpred.mapping.geometry import EGO, FREE, OCCUPIED
from envpred.metrics.windows import HorizonMetric

CODES = EGO + 1


# Of the two bits of a code, occupied has the lower alone, free the upper alone, and the others both or none: torch does
# bits several times as fast as it compares bytes, and nearly every metric asks.
def occupied(label: Tensor) -> Tensor:
    """Cells that were measured to be occupied, of a label grid (uint8) of any shape."""
    return (label & ~(label >> 1) & 1).view(torch.bool)


def measured(label: Tensor) -> Tensor:
    """Cells that were measured: occupied or free; of the others, the ego's own among them, nobody knows what was so."""
    return ((label ^ (label >> 1)) & 1).view(torch.bool)


def histograms(place: Tensor, label: Tensor, bins: int, weights: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Number of free and of occupied cells in each of `bins` bins: both (B, N, bins) float64.

    `place` (B, N, H, W) int32 is the bin of each cell, `label` (B, N, H, W); what was not measured is in neither.  With
    `weights` (B, N, H, W) their sums instead.
    """
    pairs = place.shape[:2].numel()
    # One histogram of all grids at once: [grid, code, bin].
    first = torch.arange(0, pairs * CODES, CODES, dtype=torch.int32, device=place.device).view(*place.shape[:2], 1, 1)
    flat = (label + first).mul_(bins).add_(place).flatten()
    told = None if weights is None else weights.double().flatten()
    counts = torch.bincount(flat, told, minlength=pairs * CODES * bins).view(*place.shape[:2], CODES, bins).double()
    return counts[:, :, FREE], counts[:, :, OCCUPIED]


def as_float(cells: Tensor) -> Tensor:
    """1 where there is a cell, else 0; torch turns bytes into float32 ten times as fast as it does bool."""
    return cells.view(torch.uint8).float()


class OutcomeMetric(HorizonMetric):
    """Base of what is the better the higher it is, of what was measured; where it is not defined does not count."""

    direction = "higher"
    higher_is_better = True
    skip_undefined = True
    needs_label = True
