"""Which things move in a window of grids: what a picture should point at."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from envpred.mapping.arrivals import AREA, MARGIN, arrivals


class Mover(NamedTuple):
    """A thing that moves: its centre (i, j) and radius, in cells of the grid it was found in."""

    i: float
    j: float
    radius: float


def movers(
    occupancy: NDArray[np.floating],
    centre_cell: NDArray[np.integer],
    frame: int,
    resolution: float,
    period: float,
    count: int = 2,
    area: tuple[float, float] = AREA,
) -> list[Mover]:
    """The `count` largest movers in a frame of a window, see `arrivals`.

    Args:
        occupancy: probability of occupied (T, H, W).
        centre_cell: (T, 2), where those grids lie on one lattice.
        frame: which of them.
        resolution: side of a cell in metres.
        period: seconds between frames.
        count: how many, at most.
        area: m2 of a patch, least and most.
    """
    found: list[Mover] = []
    for place in arrivals(occupancy, centre_cell, frame, resolution, period, area)[:count]:
        centre = place.mean(axis=0)
        radius = np.abs(place - centre).max() + MARGIN / resolution
        found.append(Mover(float(centre[0]), float(centre[1]), float(radius)))
    return found
