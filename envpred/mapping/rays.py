"""Rays through a grid: which cells the line from the sensor to each border cell crosses (Amanatides and Woo 1987)."""

from typing import Any

import numpy as np

from envpred.compiled import njit

# Where a ray is and how it goes on: its cell, as the number that it has in the flat grid; cells to go; steps along
# either axis in such numbers; and by how much of the line (0 at the sensor, 1 at the target) its next crossing of a
# side along the first axis lies before (< 0) or behind that along the second. This lead and what a crossing adds to
# it are counted in whole 2^-56 parts of the line: a ray is one long chain of additions and comparisons, which take
# whole numbers a third of the time.
_PARTS = 2.0**56
_FAR = 4.0  # further than any crossing on the line


@njit(nogil=True, inline="always")
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


@njit(nogil=True, inline="always")
def first_cell(x: Any, y: Any, target_i: Any, target_j: Any, rows: Any, columns: Any) -> Any:
    """The start of the line from (x, y), in cells, to the centre of a target cell of a grid.

    Returns:
        number of the line's first cell in the flat grid, cells on it in the grid, steps along either axis, the lead of
        the second axis, and what a crossing along either axis adds to or takes from it.
    """
    i, j = int(np.floor(x + 0.5)), int(np.floor(y + 0.5))
    dx, dy = target_i - x, target_j - y
    step_i, step_j = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
    # What never crosses a side crosses it further than the line goes.
    per_i = min(abs(1 / dx), _FAR) if dx != 0 else _FAR
    per_j = min(abs(1 / dy), _FAR) if dy != 0 else _FAR
    cross_i = min((i + 0.5 * step_i - x) / dx, _FAR) if dx != 0 else _FAR
    cross_j = min((j + 0.5 * step_j - y) / dy, _FAR) if dy != 0 else _FAR
    lead = int((cross_i - cross_j) * _PARTS)
    add_i, add_j = int(per_i * _PARTS), int(per_j * _PARTS)
    while not (0 <= i < rows and 0 <= j < columns):  # from outside the grid, which the line enters once
        if lead < 0:
            i, lead = i + step_i, lead + add_i
        else:
            j, lead = j + step_j, lead - add_j
    cells = abs(target_i - i) + abs(target_j - j) + 1
    return i * columns + j, cells, step_i * columns, step_j, lead, add_i, add_j


@njit(nogil=True, inline="always")
def next_cell(cell: Any, step_i: Any, step_j: Any, lead: Any, per_i: Any, per_j: Any) -> Any:
    """The next cell on the line, and the lead there."""
    if lead < 0:
        return cell + step_i, lead + per_i
    return cell + step_j, lead - per_j


@njit(nogil=True)
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
