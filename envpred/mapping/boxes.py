"""Cells in boxes of tracked objects, and which of the boxes move over ground."""

import numpy as np
from numpy.typing import NDArray

from envpred.mapping.geometry import FloatArray, GridSpec

NO_BOX, STANDS, MOVES = 0, 1, 2  # codes (uint8) of a grid of what moves
# m/s: what is slower comes on by two cells at most in the 1.5 s that are forecast, and boxes of what is parked wander
# about with the labeller's hand and the ego's heading, which is off by decimetres far away.
SLOWEST = 0.5
SPAN = 0.5  # s before and after, over which a box's motion is taken: between two scans it would be mostly that noise


def speeds(centre: FloatArray, time: FloatArray) -> FloatArray:
    """Speed (n,) in m/s of a thing at `centre` (n, 2) in metres at the times (n,) in seconds, over SPAN either way.

    0 where it is seen once.
    """
    within = SPAN + 1e-3  # stamps are rounded
    first = np.searchsorted(time, time - within)
    last = np.searchsorted(time, time + within, side="right") - 1
    took = time[last] - time[first]
    way = np.hypot(*(centre[last] - centre[first]).T)
    found: FloatArray = np.divide(way, took, out=np.zeros_like(way), where=took > 0)
    return found


def in_box(
    centre: FloatArray,
    heading: float,
    size: tuple[float, float],
    centre_cell: NDArray[np.integer],
    origin: FloatArray,
    grid: GridSpec,
) -> NDArray[np.bool_]:
    """Cells (H, W) that a box covers, seen from above.

    Args:
        centre: (2,) of the box in the world, metres.
        heading: that it looks to, radians counter-clockwise from east.
        size: length and width, metres.
        centre_cell: (2,) lattice cell at the grid's centre.
        origin: (2,) world position of the lattice's cell (0, 0).
        grid: cells and resolution.
    """
    cells = np.arange(grid.cells) - grid.half
    east = (centre_cell[0] + cells)[:, None] * grid.resolution + origin[0] - centre[0]
    north = (centre_cell[1] + cells)[None, :] * grid.resolution + origin[1] - centre[1]
    c, s = np.cos(heading), np.sin(heading)
    reach = grid.resolution / 2  # the cell that holds the returns of a side may have its centre outside
    along, across = np.abs(c * east + s * north), np.abs(c * north - s * east)
    inside: NDArray[np.bool_] = (along <= size[0] / 2 + reach) & (across <= size[1] / 2 + reach)
    return inside
