"""Worlds: the probability that a scan hits a cell, on the context grid of the last frame shown."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from envpred.errors import UserError
from envpred.mapping.geometry import OCCUPIED

Grids = NDArray[np.float32]


@dataclass(frozen=True)
class World:
    """What the future scans meet, on the lattice of the last frame shown.

    Args:
        hit: (1, I, J) for all horizons alike, or (N, I, J), probability that a scan hits the cell.
        seen: (1 or N, I, J) probability that a cell that is not hit is seen to be free from where the last frame was
            taken, or None.  The nearer a future scan is to there, the more it counts beside the rays.
        place: (2,) where the last frame was taken, in cells of the lattice.
        near: distance in metres over which the view from there loses its worth.
        part: of the context grid that `hit` is, first and end cell along either axis; None if it is the whole.
        context: cells of the context's side, None if `hit` is the whole.
    """

    hit: Grids
    seen: Grids | None = None
    place: tuple[float, float] = (0.0, 0.0)
    near: float = 0.5
    part: tuple[int, int, int, int] | None = None
    context: int | None = None

    @property
    def cells(self) -> int:
        """Cells of the context's side."""
        return self.hit.shape[-1] if self.context is None else self.context

    @property
    def first(self) -> tuple[int, int]:
        """The cell (i, j) of the context that is the first of `hit`."""
        return (0, 0) if self.part is None else self.part[:2]


def check_context(context: int, cells: int) -> None:
    """Refuse a context that is smaller than the judged grid.

    Raises:
        UserError: if it is.
    """
    if cells > context:
        raise UserError(f"the context of {context} cells is smaller than the judged grid of {cells}; build a wider one")


def label_world(label: NDArray[np.uint8], hit: float = 0.97) -> World:
    """The world in which the occupied cells of the last `label` grid (W, W) are hit with the probability `hit`."""
    return World(np.where(label == OCCUPIED, np.float32(hit), np.float32(0))[None])
