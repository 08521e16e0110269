"""Moving a grid by whole cells: what it holds, as a grid of the same lattice sees it that lies elsewhere."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:  # types alone: what needs no tensors should not load them
    from torch import Tensor

Window = tuple[slice, slice]


def overlap(shift: Sequence[int] | NDArray[np.integer], shape: Sequence[int]) -> tuple[Window, Window]:
    """Where the cells that two grids share lie, in the grid that lies `shift` (2,) cells further, and in the other.

    Args:
        shift: how much further the centre cell of the first grid lies, in cells.
        shape: (H, W) of both grids.
    """
    (to_i, from_i), (to_j, from_j) = (_along(int(s), n) for s, n in zip(shift, shape, strict=True))
    return (to_i, to_j), (from_i, from_j)


def shifted(grid: NDArray[Any], shift: Sequence[int] | NDArray[np.integer], fill: float = 0) -> NDArray[Any]:
    """`grid` (..., H, W) on a grid whose centre cell lies `shift` (2,) cells further; cells that enter are `fill`."""
    to, origin = overlap(shift, grid.shape[-2:])
    moved = np.full_like(grid, fill)
    moved[(..., *to)] = grid[(..., *origin)]
    return moved


def shifted_tensor(grid: "Tensor", shift: Sequence[int], fill: float = 0) -> "Tensor":
    """As `shifted`, for a tensor `grid` (..., H, W)."""
    to, origin = overlap(shift, grid.shape[-2:])
    moved = grid.new_full(grid.shape, fill)
    moved[(..., *to)] = grid[(..., *origin)]
    return moved


def placed(grid: "Tensor", at: Sequence[int], beyond: "Tensor") -> "Tensor":
    """`grid` (..., h, w) laid over `beyond` (..., H, W), so that its first cell becomes the cell `at` there.

    Args:
        grid: what is laid; what of it lies outside is lost.
        at: two cells, which may lie outside.
        beyond: what the other cells hold, which is not changed; its axes before the last two are those of `grid`.
    """
    sizes = zip(at, grid.shape[-2:], beyond.shape[-2:], strict=True)
    (to_i, from_i), (to_j, from_j) = (_laid(int(a), n, size) for a, n, size in sizes)
    laid = beyond.clone()
    laid[..., to_i, to_j] = grid[..., from_i, from_j]
    return laid


def _laid(at: int, n: int, size: int) -> tuple[slice, slice]:
    """Where `n` cells lie from cell `at` of `size` on, and which of them those are."""
    first, last = min(max(at, 0), size), max(min(at + n, size), 0)
    return slice(first, max(first, last)), slice(first - at, max(first, last) - at)


def _along(shift: int, size: int) -> tuple[slice, slice]:
    kept = max(size - abs(shift), 0)
    to, origin = min(max(-shift, 0), size), min(max(shift, 0), size)
    return slice(to, to + kept), slice(origin, origin + kept)
