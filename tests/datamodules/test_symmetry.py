import numpy as np
import pytest

from envpred.datamodules import symmetry


@pytest.mark.parametrize("k", range(symmetry.COUNT))
def test_cells_stay_where_they_are_on_the_lattice(k: int) -> None:
    """The lattice cell that a grid's corner covers is turned as a vector is: grid, centre cell and pose agree."""
    cells, centre = 8, np.array([[13, 21]])
    grid = np.zeros((1, cells, cells), np.float32)
    grid[0, 1, 6] = 1  # lattice cell centre - 4 + (1, 6) = (10, 23)
    turned = symmetry.turn_grid(grid, k)
    (place,) = np.argwhere(turned[0])
    lattice = symmetry.turn_cell(centre, k)[0] - cells // 2 + place
    np.testing.assert_array_equal(lattice, symmetry.turn_vector(np.array([10.0, 23.0]), k))
    pose = symmetry.turn_pose(np.array([[10.0, 23.0, 0.3]]), k)[0]
    np.testing.assert_allclose(pose[:2], lattice)


@pytest.mark.parametrize("k", range(symmetry.COUNT))
def test_heading_turns_with_the_motion(k: int) -> None:
    heading = 0.7
    moved = symmetry.turn_vector(np.array([np.cos(heading), np.sin(heading)]), k)
    turned = symmetry.turn_pose(np.array([[0.0, 0.0, heading]]), k)[0, 2]
    np.testing.assert_allclose([np.cos(turned), np.sin(turned)], moved, atol=1e-12)


def test_there_are_eight_different_symmetries_and_zero_is_none() -> None:
    grid = np.arange(16, dtype=np.float32).reshape(4, 4)
    assert len({symmetry.turn_grid(grid, k).tobytes() for k in range(symmetry.COUNT)}) == 8
    np.testing.assert_array_equal(symmetry.turn_grid(grid, 0), grid)


def test_by_hand() -> None:
    grid = np.array([[1, 2], [3, 4]], np.float32)  # grid[i, j], i east
    np.testing.assert_array_equal(symmetry.turn_grid(grid, 1), [[1, 3], [2, 4]])
    np.testing.assert_array_equal(symmetry.turn_grid(grid, 2), [[3, 4], [1, 2]])
    np.testing.assert_array_equal(symmetry.turn_grid(grid, 4), [[2, 1], [4, 3]])
    np.testing.assert_array_equal(symmetry.turn_vector(np.array([1.0, 2.0]), 3), [-2.0, 1.0])
    np.testing.assert_array_equal(symmetry.turn_cell(np.array([5, 9]), 4), [5, -8])
