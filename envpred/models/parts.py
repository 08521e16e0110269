"""What a rollout's forecast is made of, for pictures."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from envpred.mapping.movers import Movers, carried_on
from envpred.mapping.world import World


class Parts(NamedTuple):
    """What the forecasts of a batch are made of.

    Args:
        world: (B, N, W, W) probability that a scan hits a cell, on the context grid of the last frame shown; NaN where
            no ego future looks.
        rendered: (B, N, H, W) probability of occupied in the ego's grids, as rays measure that world.
        corrected: (B, N, H, W) the same, corrected by a network, of a forecaster that has one.
    """

    world: Tensor
    rendered: Tensor
    corrected: Tensor | None = None


def whole_world(
    world: World, movers: Movers | None, centre_cell: NDArray[np.int64], times: tuple[int, float, float]
) -> NDArray[np.float32]:
    """Probability of a hit (N, cells, cells) on the context grid, with what moves where it is likeliest to be.

    Args:
        world: what stands.
        movers: what moves.
        centre_cell: (2,) lattice cell at the context grid's centre.
        times: horizons N, seconds between frames and the side of a cell in metres.
    """
    horizons, period, resolution = times
    cells, (first_i, first_j) = world.cells, world.first
    grids = np.zeros((horizons, cells, cells), np.float32)
    height, width = world.hit.shape[-2:]
    grids[:, first_i : first_i + height, first_j : first_j + width] = world.hit
    places, hits = carried_on(movers, None, horizons, period, resolution)
    for grid, place, hit in zip(grids, places - (centre_cell - cells // 2), hits, strict=True):
        inside = ((place >= 0) & (place < cells)).all(axis=1)
        np.maximum.at(grid, tuple(place[inside].T), hit[inside])
    return grids


def hide_unseen(grids: NDArray[np.float32], first: NDArray[np.int64], end: NDArray[np.int64]) -> None:
    """Make `grids` (N, W, W) NaN but for cells from `first` (N, 2) up to `end` (N, 2) at each horizon."""
    for grid, (i, j), (to_i, to_j) in zip(grids, np.maximum(first, 0), np.maximum(end, 0), strict=True):
        grid[:i], grid[to_i:], grid[:, :j], grid[:, to_j:] = (np.float32(np.nan),) * 4
