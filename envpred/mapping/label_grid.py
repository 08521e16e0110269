"""Label grids by ray casting: which cells are occupied, free, covered by the ego, or unknown (Itkina et al. 2019)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from envpred.compiled import njit
from envpred.errors import check_number
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

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            least = 0 if name == "nearest" else -100  # a margin may also make the box smaller than the body, or nothing
            check_number(f"rays.{name}", value, least, 100)

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
        mark_ego(grid, shift[0], shift[1], heading, ego, spec.resolution, EGO)
        if context is not None:
            _cast_rays(wide, shift[0] + rim, shift[1] + rim)
            mark_ego(wide, shift[0] + rim, shift[1] + rim, heading, ego, spec.resolution, EGO)
        return grid, wide


@njit(nogil=True)
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


@njit(nogil=True)
def _cast_rays(grid, x, y):  # type: ignore[no-untyped-def]
    """Free the cells between the sensor at (x, y), in cells, and the first occupied cell towards every border cell."""
    (H, W), flat = grid.shape, grid.reshape(-1)
    for n in range(2 * (H + W) - 4):
        target_i, target_j = border_cell(n, H, W)
        cell, cells, step_i, step_j, lead, per_i, per_j = first_cell(x, y, target_i, target_j, H, W)
        for _ in range(cells):
            at = np.uint64(cell)  # unsigned: no index from the end to look for
            if flat[at] == OCCUPIED:
                break
            flat[at] = FREE
            cell, lead = next_cell(cell, step_i, step_j, lead, per_i, per_j)
