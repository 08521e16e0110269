"""Worlds: the probability that a scan hits a cell, on the context grid of the last frame shown."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from envpred.mapping.geometry import OCCUPIED

Grids = NDArray[np.float32]


@dataclass(frozen=True)
class World:
    """What the future scans meet, on the lattice of the last frame shown.

    Args:
        hit: (1, W, W) for all horizons alike, or (N, W, W), probability that a scan hits the cell.
        seen: (1 or N, W, W) probability that a cell that is not hit is seen to be free from where the last frame was
            taken, or None.  The nearer a future scan is to there, the more it counts beside the rays.
        place: (2,) where the last frame was taken, in cells of the lattice.
        near: distance in metres over which the view from there loses its worth.
    """

    hit: Grids
    seen: Grids | None = None
    place: tuple[float, float] = (0.0, 0.0)
    near: float = 0.5


def label_world(label: NDArray[np.uint8], hit: float = 0.97) -> World:
    """The world in which the occupied cells of the last `label` grid (W, W) are hit with the probability `hit`."""
    return World(np.where(label == OCCUPIED, np.float32(hit), np.float32(0))[None])
