"""The grid and its lattice: the only owner of grid numbers."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from envpred.errors import UserError, check_number

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int32]

# Sensor to body (IMU) of KITTI's car as the paper's reference code takes it: no rotation, metres.
PAPER_SENSOR_OFFSET = np.array([[1, 0, 0, 0.81], [0, 1, 0, -0.32], [0, 0, 1, 0.80], [0, 0, 0, 1]], np.float64)
PAPER_SENSOR_HEIGHT = 1.73  # of KITTI's sensor above the road, metres

MOST_CELLS = 8192  # along a side: more than half a gigabyte a frame

# Codes of a label grid (uint8).
UNKNOWN, OCCUPIED, FREE, EGO = 0, 1, 2, 3


@dataclass(frozen=True)
class Body:
    """The ego vehicle's body in the sensor frame, in metres; by default KITTI's as the paper's reference code has it.

    Args:
        rear: x (forward) of its rear, negative where the sensor sits before it.
        front: x of its front.
        half_width: how far it reaches to the left and to the right.
    """

    rear: float = -0.81
    front: float = 0.27 + 1.68
    half_width: float = 0.8

    def __post_init__(self) -> None:
        if not (self.rear < self.front and self.half_width > 0):
            raise ValueError(f"a body needs its rear behind its front and a positive half width, not {self}")


PAPER_BODY = Body()


@dataclass(frozen=True)
class GridSpec:
    """A square grid of `cells` x `cells` cells of `resolution` metres, first axis east, second north.

    All grids of a drive are cut from one lattice whose cell (i, j) is centred on `origin + resolution * (i, j)`, so
    that between frames a grid moves by whole cells.
    """

    cells: int = 128
    resolution: float = 1 / 3

    def __post_init__(self) -> None:
        if self.cells < 2 or self.cells % 2:
            raise UserError(f"--grid.cells {self.cells}: give an even number of at least 2")
        check_number("grid.cells", self.cells, 2, MOST_CELLS)
        check_number("grid.resolution", self.resolution, above=True)

    @property
    def half(self) -> int:
        """Cells west (south) of the centre cell."""
        return self.cells // 2

    @property
    def side(self) -> float:
        """Side of the grid in metres."""
        return self.cells * self.resolution

    @property
    def reach(self) -> float:
        """How far along either axis (metres) the sensor's points cover the grid whatever the ego's heading.

        sqrt(2) (side / 2 + 1 m), as in the paper's reference code; the metre is for where the sensor sits in the body.
        """
        return float(np.sqrt(2) * (self.side / 2 + 1.0))

    def wider(self, cells: int) -> "GridSpec":
        """A grid of `cells` around this one, on the same lattice and with the same centre cell.

        Raises:
            UserError: if it is odd or smaller than this one.
        """
        if cells < self.cells or cells % 2:
            raise UserError(f"--context {cells}: give an even number of cells of at least the grid's {self.cells}")
        return replace(self, cells=cells)

    def lattice_origin(self, positions: FloatArray) -> FloatArray:
        """World position (2,) of lattice cell (0, 0) for a drive with IMU `positions` (T, >=2), in metres.

        It lies one grid's side west and south of the drive's extremes, as in the paper's reference code.
        """
        southwest: FloatArray = np.asarray(positions, np.float64)[:, :2].min(axis=0)
        return southwest - self.side

    def cell_of(self, positions: FloatArray, origin: FloatArray) -> IntArray:
        """Lattice cell (..., 2) int32 that holds each of the world `positions` (..., >=2), in metres."""
        return np.floor(self.in_cells(positions, origin) + 0.5).astype(np.int32)

    def in_cells(self, positions: FloatArray, origin: FloatArray) -> FloatArray:
        """World `positions` (..., >=2) in cells from the lattice's origin; cell (i, j) is centred on (i, j)."""
        return (np.asarray(positions, np.float64)[..., :2] - origin) / self.resolution


def transform(points: NDArray[np.floating], pose: FloatArray) -> FloatArray:
    """`points` (N, >=3) moved by the rigid `pose` (4, 4): (N, 3) in metres."""
    moved: FloatArray = points[:, :3] @ pose[:3, :3].T + pose[:3, 3]
    return moved


def heading_of(poses: FloatArray) -> FloatArray:
    """Heading (...,) in radians, counter-clockwise from east, of `poses` (..., 4, 4) with x forward."""
    return np.arctan2(poses[..., 1, 0], poses[..., 0, 0])
