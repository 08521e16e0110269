"""Grids as ROS defines them, worked out by hand."""

import numpy as np

from envpred.live.occupancy_grid import forecast_grids, maximum, occupancy_grid
from tests.live.forecasts import HOME, cell, empty, standing


def test_a_grid_of_three_by_two_cells() -> None:
    """Ours is [i][j], east then north; ROS's goes east first, from the south: data[x + y * width]."""
    probability = np.array([[0.0, 0.1], [0.25, 1.0], [np.nan, 0.996]], np.float32)
    grid = occupancy_grid(probability, (4, 6), (100.0, 200.0), 0.5, stamp=2.5, load_time=2.0)
    assert (grid.width, grid.height, grid.resolution) == (3, 2, 0.5)
    assert grid.data.dtype == np.int8
    assert grid.data.tolist() == [0, 25, -1, 10, 100, 100]
    assert grid.rows.tolist() == [[0, 25, -1], [10, 100, 100]]
    # The middle of lattice cell (4, 6) lies at (102, 203); ROS names the outer corner of the first cell.
    assert grid.origin == (101.75, 202.75)
    assert (grid.stamp, grid.load_time) == (2.5, 2.0)


def test_every_horizon_has_its_place_and_time() -> None:
    known = np.ones((48, 48), np.bool_)
    known[24 + 6, 24 + 5] = False  # x = 26, y = 20
    grids = empty(2)
    grids[0][cell(27)], grids[:, cell(26)[0], cell(26)[1]] = 0.42, 0.9
    ego = np.array([HOME, HOME + np.array([3.4, -1.6, 0])])
    first, second = forecast_grids(standing(grids, ego=ego, known=known, time=7.0, origin=(1000.0, 0.0)))
    assert (first.stamp, second.stamp, first.load_time, second.load_time) == (8.0, 9.0, 7.0, 7.0)
    assert first.origin == (1000 + 20 - 8 - 0.5, 15 - 8 - 0.5)
    assert second.origin == (1000 + 23 - 8 - 0.5, 13 - 8 - 0.5)
    i, j = cell(27)
    assert first.rows[j, i] == 42
    assert first.rows[j, i - 1] == -1
    assert second.rows[j + 2, i - 3 - 1] == -1


def test_the_maximum_covers_all_and_knows_more_than_unknown() -> None:
    a = occupancy_grid(np.array([[0.1, np.nan], [0.3, np.nan]], np.float32), (0, 0), (0.0, 0.0), 1 / 3, 1.0, 0.5)
    b = occupancy_grid(np.array([[0.2, 0.0], [0.9, 0.4]], np.float32), (1, -1), (0.0, 0.0), 1 / 3, 2.0, 0.5)
    both = maximum([a, b])
    assert both.rows.tolist() == [[-1, 20, 90], [10, 30, 40], [-1, -1, -1]]
    np.testing.assert_allclose(both.origin, (-1 / 6, -1 / 3 - 1 / 6))
    assert (both.stamp, both.load_time) == (2.0, 0.5)
    assert maximum([a]).data.tolist() == a.data.tolist()
