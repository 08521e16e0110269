"""Cells around what moves."""

import numpy as np

from envpred.mapping.arrivals import arrivals, moving_cells
from tests.results.scenes import window


def test_a_car_and_a_metre_around_it() -> None:
    """Three by three cells of a car at (43, 32) in frame 8; neither the wall nor the ego."""
    occupancy, centre_cell = window()
    (car,) = arrivals(occupancy, centre_cell, 8, 1 / 3, 0.1)
    low, high = car.min(axis=0), car.max(axis=0)
    moving = moving_cells(occupancy, centre_cell, 5, 1 / 3, 0.1)
    assert moving.shape == (len(occupancy) - 5, *occupancy.shape[1:])
    inside = np.argwhere(moving[8 - 5])
    assert inside.min(axis=0).tolist() == (low - 3).tolist()
    assert inside.max(axis=0).tolist() == (high + 3).tolist()
    assert len(inside) == np.prod(high - low + 7)


def test_who_stands_does_not_move() -> None:
    occupancy, centre_cell = window()
    still = np.repeat(occupancy[8:9], 10, axis=0)
    assert not moving_cells(still, np.repeat(centre_cell[8:9], 10, axis=0), 3, 1 / 3, 0.1).any()
