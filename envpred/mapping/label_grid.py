"""Label grids by ray casting: which cells are occupied, free, covered by the ego, or unknown (Itkina et al. 2019)."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from envpred.mapping.geometry import (
    EGO,
    FREE,
    OCCUPIED,
    PAPER_BODY,
    Body,
    FloatArray,
    GridSpec,
    IntArray,
    heading_of,
)
from envpred.mapping.rays import border_cell, first_cell, mark_ego, next_cell


@dataclass(frozen=True)
class RayCasting:
    """How obstacle points become a label grid.

    Args:
        rear_margin: added behind the ego's body, in metres; returns inside body and margins come from the ego itself.
        front_margin: added before the ego's body, in metres.
        side_margin: added at both sides of the ego's body, in metres.
        nearest: points nearer to the sensor than this (in the plane, metres) are dropped.
    """

    rear_margin: float = 0.7 + 1 / 6
    front_margin: float = 0.8 + 1 / 6
    side_margin: float = 0.7 + 1 / 6
    nearest: float = 0.8

    def label(
        self,
        points: NDArray[np.float32],
        obstacle: NDArray[np.bool_],
        sensor_pose: FloatArray,
        centre_cell: IntArray,
        origin: FloatArray,
        spec: GridSpec,
        body: Body = PAPER_BODY,
    ) -> NDArray[np.uint8]:
        """The label grid (H, W) uint8 of one scan.

        Args:
            points: (N, >=3) in the sensor frame, metres.
            obstacle: (N,) which of them are obstacles.
            sensor_pose: (4, 4) sensor frame to world.
            centre_cell: (2,) lattice cell at the grid's centre.
            origin: (2,) world position of lattice cell (0, 0), metres.
            spec: the grid.
            body: of the ego.
        """
        # World position, in cells, of the centre of the local grid's cell (0, 0).
        corner = (np.asarray(centre_cell) - spec.half).astype(np.float64)
        shift = (sensor_pose[:2, 3] - origin) / spec.resolution - corner
        rotation = sensor_pose[:2, :3] / spec.resolution
        grid = np.zeros((spec.cells, spec.cells), np.uint8)
        box = (
            body.rear - self.rear_margin,
            body.front + self.front_margin,
            body.half_width + self.side_margin,
        )
        _mark_occupied(grid, points, obstacle, rotation, shift, box, self.nearest / spec.resolution)
        _cast_rays(grid, shift[0], shift[1])
        heading, ego = float(heading_of(sensor_pose)), (body.rear, body.front, body.half_width)
        mark_ego(grid, shift[0], shift[1], heading, ego, spec.resolution, EGO)
        return grid


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _mark_occupied(grid, points, obstacle, rotation, shift, box, nearest):  # type: ignore[no-untyped-def]
    """A cell that holds an obstacle point outside the ego's surroundings is occupied."""
    rear, front, half_width = box
    # Locals, because the compiler cannot know that writing to the grid leaves these arrays alone.
    ux, uy, uz, vx, vy, vz = rotation.flat
    east, north = shift
    for n in range(len(points)):
        if not obstacle[n]:
            continue
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        if rear <= x <= front and abs(y) <= half_width:
            continue
        u, v = ux * x + uy * y + uz * z, vx * x + vy * y + vz * z
        if u * u + v * v < nearest * nearest:
            continue
        i, j = int(np.floor(u + east + 0.5)), int(np.floor(v + north + 0.5))
        if 0 <= i < grid.shape[0] and 0 <= j < grid.shape[1]:
            grid[i, j] = OCCUPIED


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _cast_rays(grid, x, y):  # type: ignore[no-untyped-def]
    """Free the cells between the sensor at (x, y), in cells, and the first occupied cell towards every border cell."""
    H, W = grid.shape
    for n in range(2 * (H + W) - 4):
        target_i, target_j = border_cell(n, H, W)
        i, j, cells, step_i, step_j, cross_i, cross_j, per_i, per_j = first_cell(x, y, target_i, target_j)
        for _ in range(cells):
            if 0 <= i < H and 0 <= j < W:
                if grid[i, j] == OCCUPIED:
                    break
                grid[i, j] = FREE
            i, j, cross_i, cross_j = next_cell(i, j, step_i, step_j, cross_i, cross_j, per_i, per_j)
