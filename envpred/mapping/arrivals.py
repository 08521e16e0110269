"""What has moved into a place: cells that are occupied now and were seen to be free there half a second ago."""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from envpred.mapping.shift import shifted

OCCUPIED_FROM, FREE_BELOW = 0.85, 0.20  # as the image similarity's classes: sure of it either way
EGO_REACH = 3.0  # m that the ego's body reaches from the centre cell
AREA = (0.44, 13.4)  # m2 that moved into; less is noise, more a wall that came into sight
MARGIN = 1.0  # m around what moves
BACK_S = 0.5  # s for which a mover's place was free before
EIGHT = np.ones((3, 3), np.bool_)  # cells that touch at a corner belong together


def arrivals(
    occupancy: NDArray[np.floating],
    centre_cell: NDArray[np.integer],
    frame: int,
    resolution: float,
    period: float,
    area: tuple[float, float] = AREA,
) -> list[NDArray[np.int64]]:
    """The cells (n, 2) of each thing that has moved in a frame of a window, the largest first.

    Cells that are occupied now and were seen to be free half a second ago, at the same place in the world, joined
    where they touch.  The ego, at the grid's centre, is left out.

    Args:
        occupancy: probability of occupied (T, H, W).
        centre_cell: (T, 2), where those grids lie on one lattice.
        frame: which of them.
        resolution: side of a cell in metres.
        period: seconds between frames.
        area: m2 of a thing, least and most.
    """
    before = max(0, frame - max(1, round(BACK_S / period)))
    earlier = shifted(occupancy[before], centre_cell[frame] - centre_cell[before], fill=0.5)
    came = (occupancy[frame] >= OCCUPIED_FROM) & (earlier < FREE_BELOW)
    patches, _ = ndimage.label(came, EIGHT)
    cells, patch = np.argwhere(came), patches[came]
    sizes = np.bincount(patch, minlength=1)[1:]
    places = np.split(cells[np.argsort(patch, kind="stable")], np.cumsum(sizes)[:-1]) if len(sizes) else []
    middle = np.array(came.shape) // 2
    found = []
    for n in np.argsort(-sizes, kind="stable"):
        thing = area[0] <= sizes[n] * resolution**2 <= area[1]
        if thing and np.hypot(*(places[n].mean(axis=0) - middle)) * resolution >= EGO_REACH:
            found.append(places[n])
    return found


def moving_cells(
    occupancy: NDArray[np.floating],
    centre_cell: NDArray[np.integer],
    first: int,
    resolution: float,
    period: float,
) -> NDArray[np.bool_]:
    """The cells (T - first, H, W) within MARGIN, in either axis, of what has moved in each frame from the `first` on.

    Args: as `arrivals`.
    """
    found = np.zeros((len(occupancy) - first, *occupancy.shape[1:]), np.bool_)
    for cells, frame in zip(found, range(first, len(occupancy)), strict=True):
        for place in arrivals(occupancy, centre_cell, frame, resolution, period):
            cells[tuple(place.T)] = True
    return around(found, resolution)


def around(cells: NDArray[np.bool_], resolution: float) -> NDArray[np.bool_]:
    """The cells within MARGIN, in either axis, of `cells` (T, H, W)."""
    side = 2 * round(MARGIN / resolution) + 1
    found = np.zeros_like(cells)
    for t in np.flatnonzero(cells.any(axis=(1, 2))):
        found[t] = ndimage.maximum_filter(cells[t], side, mode="constant")
    return found
