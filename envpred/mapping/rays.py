"""Rays through a grid: which cells the line from the sensor to each border cell crosses (Amanatides and Woo 1987)."""

from typing import Any

import numpy as np
from numba import njit

# Where a ray is and how it goes on: cell i, j; cells to go; steps; where along the line (0 at the sensor, 1 at the
# target) it next crosses a cell's side, and how far apart these crossings are, for either axis.


@njit(cache=True, nogil=True, inline="always")  # type: ignore[untyped-decorator, unused-ignore]
def border_cell(n: Any, rows: Any, columns: Any) -> Any:
    """Border cell (i, j) number `n` of the 2 (rows + columns) - 4 of a grid."""
    if n < rows:
        return n, 0
    n -= rows
    if n < rows:
        return n, columns - 1
    n -= rows
    if n < columns - 2:
        return 0, n + 1
    return rows - 1, n - (columns - 2) + 1


@njit(cache=True, nogil=True, inline="always")  # type: ignore[untyped-decorator, unused-ignore]
def first_cell(x: Any, y: Any, target_i: Any, target_j: Any) -> Any:
    """The start of the line from (x, y), in cells, to the centre of a target cell.

    Returns:
        cell i, j, number of cells on the line, steps along either axis (1 or -1), the positions along the line (0 at
        the sensor, 1 at the target) where it next crosses a side of a cell, and the distances of these crossings.
    """
    i, j = int(np.floor(x + 0.5)), int(np.floor(y + 0.5))
    dx, dy = target_i - x, target_j - y
    step_i, step_j = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
    cross_i = (i + 0.5 * step_i - x) / dx if dx != 0 else np.inf
    cross_j = (j + 0.5 * step_j - y) / dy if dy != 0 else np.inf
    per_i = abs(1 / dx) if dx != 0 else np.inf
    per_j = abs(1 / dy) if dy != 0 else np.inf
    return i, j, abs(target_i - i) + abs(target_j - j) + 1, step_i, step_j, cross_i, cross_j, per_i, per_j


@njit(cache=True, nogil=True, inline="always")  # type: ignore[untyped-decorator, unused-ignore]
def next_cell(i: Any, j: Any, step_i: Any, step_j: Any, cross_i: Any, cross_j: Any, per_i: Any, per_j: Any) -> Any:
    """The next cell i, j on the line, and its next crossings."""
    if cross_i < cross_j:
        return i + step_i, j, cross_i + per_i, cross_j
    return i, j + step_j, cross_i, cross_j + per_j


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def mark_ego(grid: Any, x: Any, y: Any, heading: Any, body: Any, resolution: Any, value: Any) -> None:
    """Give `value` to the cells whose centre lies within one cell of the ego's body, seen from the sensor.

    Args:
        grid: (H, W) what is written to.
        x: the sensor's place along the first axis, in cells.
        y: and along the second.
        heading: of the sensor, radians.
        body: rear, front and half width of the ego's body in the sensor's frame, metres.
        resolution: a cell's side, metres.
        value: what the cells get.
    """
    rear, front, half_width = body
    cos, sin = np.cos(heading), np.sin(heading)
    reach = int(np.ceil((max(front, -rear) + half_width) / resolution)) + 2
    ci, cj = int(np.rint(x)), int(np.rint(y))
    for i in range(max(ci - reach, 0), min(ci + reach + 1, grid.shape[0])):
        for j in range(max(cj - reach, 0), min(cj + reach + 1, grid.shape[1])):
            east, north = (i - x) * resolution, (j - y) * resolution
            forward, left = cos * east + sin * north, cos * north - sin * east
            if rear - resolution <= forward <= front + resolution and abs(left) <= half_width + resolution:
                grid[i, j] = value
