"""Label grids for tests."""

import torch
from torch import Tensor

from envpred.mapping.geometry import FREE, OCCUPIED, UNKNOWN


def labelled(target: Tensor) -> Tensor:
    """What was measured if probabilities (...) say so: occupied above a half, free below it, nothing at it."""
    codes = torch.full_like(target, UNKNOWN, dtype=torch.uint8)
    codes[target > 0.5], codes[target < 0.5] = OCCUPIED, FREE
    return codes
