"""Grids as ROS has them: the content of a nav_msgs/OccupancyGrid, as plain arrays."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from envpred.live.placed import Grids, PlacedForecast
from envpred.mapping.ego_motion import cells_of

UNSEEN = -1


@dataclass(frozen=True)
class OccupancyGrid:
    """What a nav_msgs/OccupancyGrid says, in a frame whose x points east and whose y points north.

    Args:
        data: (height * width,) int8, row by row from the south, each from west to east: the probability of occupied in
            percent, or -1 where nothing is known.
        width: cells from west to east.
        height: cells from south to north.
        resolution: side of a cell in metres.
        origin: x and y of the outer corner of the first cell, in the south-west, in metres; it is not turned.
        stamp: the time that it is about, seconds.
        load_time: when it was made, seconds.
    """

    data: NDArray[np.int8]
    width: int
    height: int
    resolution: float
    origin: tuple[float, float]
    stamp: float
    load_time: float

    @property
    def rows(self) -> NDArray[np.int8]:
        """The data as (height, width), the first row in the south."""
        return self.data.reshape(self.height, self.width)


def occupancy_grid(
    probability: Grids,
    first_cell: Sequence[int] | NDArray[np.integer],
    origin: tuple[float, float],
    resolution: float,
    stamp: float,
    load_time: float,
) -> OccupancyGrid:
    """A grid as ROS has it.

    Args:
        probability: (H, W) of occupied, first axis east, second north; not a number where nothing is known.
        first_cell: lattice cell of its first cell.
        origin: (2,) the centre of lattice cell (0, 0), metres.
        resolution: side of a cell in metres.
        stamp: see `OccupancyGrid`.
        load_time: likewise.
    """
    percent = np.where(np.isnan(probability), UNSEEN, np.rint(100 * np.clip(probability, 0, 1)))
    corner = (np.asarray(first_cell) - 0.5) * resolution + np.asarray(origin)
    width, height = probability.shape
    # x is the fast axis there, and the slow one here.
    data = np.ascontiguousarray(percent.T).ravel().astype(np.int8)
    return OccupancyGrid(data, width, height, resolution, (float(corner[0]), float(corner[1])), stamp, load_time)


def forecast_grids(forecast: PlacedForecast) -> list[OccupancyGrid]:
    """The forecast's horizons, each stamped with the time that it is about, without the ego.

    A cell is -1 where nothing is known of it at the last frame shown (less than 0.05 of mass for occupied and free
    together: never measured, or not for 2.8 s), whatever a forecaster guesses there.
    """
    corners = cells_of(forecast.ego) - forecast.probability.shape[-1] // 2
    place = forecast.origin, forecast.resolution
    return [
        occupancy_grid(grid, corner, *place, forecast.time + float(ahead), forecast.time)
        for grid, corner, ahead in zip(forecast.told(), corners, forecast.horizon_s, strict=True)
    ]


def maximum(grids: Sequence[OccupancyGrid]) -> OccupancyGrid:
    """The largest value of each cell over `grids` of one lattice, on a grid that holds them all, stamped as the last.

    Unknown is less than anything known.
    """
    resolution = grids[0].resolution
    corners = np.array([grid.origin for grid in grids])
    first = corners.min(axis=0)
    at = np.rint((corners - first) / resolution).astype(int)
    width, height = (at + [(grid.width, grid.height) for grid in grids]).max(axis=0).tolist()
    rows = np.full((height, width), UNSEEN, np.int8)
    for grid, (x, y) in zip(grids, at.tolist(), strict=True):
        part = rows[y : y + grid.height, x : x + grid.width]
        np.maximum(part, grid.rows, out=part)
    origin = float(first[0]), float(first[1])
    return OccupancyGrid(rows.ravel(), width, height, resolution, origin, grids[-1].stamp, grids[-1].load_time)
