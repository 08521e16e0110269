"""Which things move in a window of grids: what a picture should point at."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from envpred.mapping.shift import shifted

OCCUPIED_FROM, FREE_BELOW = 0.85, 0.20  # as the image similarity's classes: sure of it either way
EGO_REACH = 3.0  # m that the ego's body reaches from the centre cell
AREA = (0.44, 13.4)  # m2 that moved into; less is noise, more a wall that came into sight
MARGIN = 1.0  # m around a mover
BACK_S = 0.5  # s for which a mover's place was free before
EIGHT = np.ones((3, 3), np.bool_)  # cells that touch at a corner belong together


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
    """The `count` largest movers in a frame of a window.

    Cells that are occupied now and were seen to be free half a second ago, at the same place in the world, joined
    where they touch.  The ego, at the grid's centre, is left out.

    Args:
        occupancy: probability of occupied (T, H, W).
        centre_cell: (T, 2), where those grids lie on one lattice.
        frame: which of them.
        resolution: side of a cell in metres.
        period: seconds between frames.
        count: how many, at most.
        area: m2 of a patch, least and most.
    """
    before = max(0, frame - max(1, round(BACK_S / period)))
    earlier = shifted(occupancy[before], centre_cell[frame] - centre_cell[before], fill=0.5)
    came = (occupancy[frame] >= OCCUPIED_FROM) & (earlier < FREE_BELOW)
    patches, _ = ndimage.label(came, EIGHT)
    sizes = np.bincount(patches.ravel())
    found: list[Mover] = []
    for n in np.argsort(-sizes, kind="stable"):
        place = np.argwhere(patches == n)
        centre = place.mean(axis=0)
        is_ego = np.hypot(*(centre - np.array(came.shape) // 2)) * resolution < EGO_REACH
        if n > 0 and area[0] <= sizes[n] * resolution**2 <= area[1] and not is_ego and len(found) < count:
            radius = np.abs(place - centre).max() + MARGIN / resolution
            found.append(Mover(float(centre[0]), float(centre[1]), float(radius)))
    return found
