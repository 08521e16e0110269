"""Moving a grid by whole cells: what stays in the world stays in the world."""

import numpy as np
import torch
from hypothesis import given
from hypothesis import strategies as st

from envpred.mapping.shift import overlap, shifted, shifted_tensor

cells = st.integers(-7, 7)


def test_a_grid_further_east_sees_things_further_west() -> None:
    grid = np.arange(6).reshape(3, 2)
    assert shifted(grid, (1, 0), fill=9).tolist() == [[2, 3], [4, 5], [9, 9]]
    assert shifted(grid, (0, -1)).tolist() == [[0, 0], [0, 2], [0, 4]]


@given(cells, cells)
def test_a_cell_keeps_its_place_in_the_world(east: int, north: int) -> None:
    grid = np.arange(1, 31).reshape(2, 3, 5)
    moved = shifted(grid, np.array([east, north]))
    for i in range(3):
        for j in range(5):
            si, sj = i + east, j + north
            inside = 0 <= si < 3 and 0 <= sj < 5
            assert moved[:, i, j].tolist() == (grid[:, si, sj].tolist() if inside else [0, 0])
    np.testing.assert_array_equal(shifted_tensor(torch.from_numpy(grid), (east, north), 0).numpy(), moved)


@given(cells, cells)
def test_both_windows_show_the_same_cells_of_the_world(east: int, north: int) -> None:
    there, here = overlap((east, north), (3, 5))
    i, j = np.meshgrid(np.arange(3), np.arange(5), indexing="ij")
    np.testing.assert_array_equal(i[there] + east, i[here])
    np.testing.assert_array_equal(j[there] + north, j[here])
