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

NOTHING, ANYWHERE = np.zeros((0, 0), np.uint8), np.float32(np.inf)  # no wider grid, and no limit to the judged one's


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
        return self._cast(points, obstacle, sensor_pose, centre_cell, origin, body, spec)[0]

    def labels(
        self,
        points: NDArray[np.float32],
        obstacle: NDArray[np.bool_],
        sensor_pose: FloatArray,
        centre_cell: IntArray,
        origin: FloatArray,
        spec: GridSpec,
        context: GridSpec,
        body: Body = PAPER_BODY,
    ) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """The label grids of one scan on the judged grid and on a wider one with the same centre.

        Points out of the judged grid's reach have no part in it, whatever the sensor's tilt: it is what it is alone.

        Args:
            points: (N, >=3) in the sensor frame, metres.
            obstacle: (N,) which of them are obstacles.
            sensor_pose: (4, 4) sensor frame to world.
            centre_cell: (2,) lattice cell at the grids' centre.
            origin: (2,) world position of lattice cell (0, 0), metres.
            spec: the judged grid.
            context: the wider one.
            body: of the ego.
        """
        return self._cast(
            points, obstacle, sensor_pose, centre_cell, origin, body, spec, context, np.float32(spec.reach)
        )

    def _cast(
        self,
        points: NDArray[np.float32],
        obstacle: NDArray[np.bool_],
        sensor_pose: FloatArray,
        centre_cell: IntArray,
        origin: FloatArray,
        body: Body,
        spec: GridSpec,
        context: GridSpec | None = None,
        reach: np.float32 = ANYWHERE,
    ) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        # World position, in cells, of the centre of the local grid's cell (0, 0).
        corner = (np.asarray(centre_cell) - spec.half).astype(np.float64)
        shift = (sensor_pose[:2, 3] - origin) / spec.resolution - corner
        rotation = sensor_pose[:2, :3] / spec.resolution
        grid = np.zeros((spec.cells, spec.cells), np.uint8)
        wide, rim = NOTHING, 0
        if context is not None:
            wide, rim = np.zeros((context.cells, context.cells), np.uint8), context.half - spec.half
        box = (
            body.rear - self.rear_margin,
            body.front + self.front_margin,
            body.half_width + self.side_margin,
        )
        nearest = self.nearest / spec.resolution
        _mark_occupied(grid, wide, rim, reach, points, obstacle, rotation, shift, box, nearest)
        ego, heading = (body.rear, body.front, body.half_width), float(heading_of(sensor_pose))
        _cast_rays(grid, shift[0], shift[1])
        _mark_ego(grid, shift, heading, ego, spec.resolution)
        if context is not None:
            _cast_rays(wide, shift[0] + rim, shift[1] + rim)
            _mark_ego(wide, shift + rim, heading, ego, spec.resolution)
        return grid, wide


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _mark_occupied(grid, wide, rim, reach, points, obstacle, rotation, shift, box, nearest):  # type: ignore[no-untyped-def]
    """A cell that holds an obstacle point outside the ego's surroundings is occupied.

    The grid takes points within `reach` alone; it begins at cell (rim, rim) of the wide one, which may be empty.
    """
    rear, front, half_width = box
    # Locals, because the compiler cannot know that writing to the grid leaves these arrays alone.
    ux, uy, uz, vx, vy, vz = rotation.flat
    east, north = shift
    both = len(wide) > 0
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
        if both:
            if 0 <= i + rim < wide.shape[0] and 0 <= j + rim < wide.shape[1]:
                wide[i + rim, j + rim] = OCCUPIED
            if abs(x) > reach or abs(y) > reach:
                continue
        if 0 <= i < grid.shape[0] and 0 <= j < grid.shape[1]:
            grid[i, j] = OCCUPIED


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _cast_rays(grid, x, y):  # type: ignore[no-untyped-def]
    """Free the cells between the sensor at (x, y), in cells, and the first occupied cell towards every border cell."""
    last_i, last_j = grid.shape[0] - 1, grid.shape[1] - 1
    for i in range(last_i + 1):
        _cast_ray(grid, x, y, i, 0)
        _cast_ray(grid, x, y, i, last_j)
    for j in range(1, last_j):
        _cast_ray(grid, x, y, 0, j)
        _cast_ray(grid, x, y, last_i, j)


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _cast_ray(grid, x, y, target_i, target_j):  # type: ignore[no-untyped-def]
    """Walk the cells on one line (Amanatides and Woo 1987) and free them up to the first occupied one."""
    i, j = int(np.floor(x + 0.5)), int(np.floor(y + 0.5))
    dx, dy = target_i - x, target_j - y
    step_i, step_j = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
    # Position along the line, 0 at the sensor and 1 at the target, where it next crosses a cell's side.
    cross_i = (i + 0.5 * step_i - x) / dx if dx != 0 else np.inf
    cross_j = (j + 0.5 * step_j - y) / dy if dy != 0 else np.inf
    per_i = abs(1 / dx) if dx != 0 else np.inf
    per_j = abs(1 / dy) if dy != 0 else np.inf
    for _ in range(abs(target_i - i) + abs(target_j - j) + 1):
        if 0 <= i < grid.shape[0] and 0 <= j < grid.shape[1]:
            if grid[i, j] == OCCUPIED:
                return
            grid[i, j] = FREE
        if cross_i < cross_j:
            i += step_i
            cross_i += per_i
        else:
            j += step_j
            cross_j += per_j


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _mark_ego(grid, sensor, heading, ego, resolution):  # type: ignore[no-untyped-def]
    """Cells whose centre lies within one cell of the ego's body, seen from the sensor, belong to the ego."""
    cos, sin = np.cos(heading), np.sin(heading)
    rear, front, half_width = ego
    reach = int(np.ceil((max(front, -rear) + half_width) / resolution)) + 2
    ci, cj = int(np.rint(sensor[0])), int(np.rint(sensor[1]))
    for i in range(max(ci - reach, 0), min(ci + reach + 1, grid.shape[0])):
        for j in range(max(cj - reach, 0), min(cj + reach + 1, grid.shape[1])):
            east, north = (i - sensor[0]) * resolution, (j - sensor[1]) * resolution
            forward, left = cos * east + sin * north, cos * north - sin * east
            if rear - resolution <= forward <= front + resolution and abs(left) <= half_width + resolution:
                grid[i, j] = EGO
