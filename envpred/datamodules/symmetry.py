"""The eight symmetries of a square grid (four rotations, each also mirrored), for grids, lattice cells and velocities.

A symmetry is a number from 0 to 7: bit 0 exchanges east and north, then bits 1 and 2 turn the first and second axis
round.  0 leaves everything as it is.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

COUNT = 8


def turn_grid(grid: NDArray[Any], symmetry: int) -> NDArray[Any]:
    """`grid` (..., H, H) turned; a view."""
    if symmetry & 1:
        grid = grid.swapaxes(-1, -2)
    if symmetry & 2:
        grid = grid[..., ::-1, :]
    if symmetry & 4:
        grid = grid[..., :, ::-1]
    return grid


def turn_vector(vector: NDArray[np.floating], symmetry: int) -> NDArray[np.floating]:
    """Vectors (..., 2), east and north, turned."""
    turned = vector[..., ::-1].copy() if symmetry & 1 else vector.copy()
    turned[..., 0] *= -1 if symmetry & 2 else 1
    turned[..., 1] *= -1 if symmetry & 4 else 1
    return turned


def turn_cell(cell: NDArray[np.integer], symmetry: int) -> NDArray[np.integer]:
    """Centre cells (..., 2) of turned grids.

    A grid has one cell more west of its centre cell than east, so a mirrored grid's centre cell is 1 - c, not -c.
    """
    turned = cell[..., ::-1].copy() if symmetry & 1 else cell.copy()
    for axis, bit in ((0, 2), (1, 4)):
        if symmetry & bit:
            turned[..., axis] = 1 - turned[..., axis]
    return turned


def turn_pose(pose: NDArray[np.floating], symmetry: int) -> NDArray[np.floating]:
    """Poses (..., 3): x and y in cells, heading in radians; the heading of a mirrored world is mirrored."""
    heading = np.stack([np.cos(pose[..., 2]), np.sin(pose[..., 2])], axis=-1)
    heading = turn_vector(heading, symmetry)
    position = turn_vector(pose[..., :2], symmetry)
    return np.concatenate([position, np.arctan2(heading[..., 1], heading[..., 0])[..., None]], axis=-1)


def turn_covariance(covariance: NDArray[np.floating], symmetry: int) -> NDArray[np.floating]:
    """Covariances (..., 3), as (xx, xy, yy), of turned vectors."""
    turned = covariance[..., ::-1].copy() if symmetry & 1 else covariance.copy()
    turned[..., 1] *= -1 if bool(symmetry & 2) != bool(symmetry & 4) else 1
    return turned


def is_mirrored(symmetry: int) -> bool:
    """Whether left and right change places: what lies to the left in the body frame then lies to the right."""
    return symmetry.bit_count() % 2 == 1
