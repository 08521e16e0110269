"""What moves in a window."""

import pytest

from envpred.results.movers import movers
from tests.results.scenes import window

KITTI = (1 / 3, 0.1)  # metres a cell, seconds a frame


def test_finds_the_car_and_neither_wall_nor_ego() -> None:
    occupancy, centre_cell = window()
    (car,) = movers(occupancy, centre_cell, 8, *KITTI)
    # In the world at (77, 80); the centre cell (66, 80) is (32, 32).
    assert (car.i, car.j) == (43, 32)
    assert 4 <= car.radius < 5
    assert movers(occupancy, centre_cell, 8, *KITTI, area=(1.1, 11)) == []
    assert movers(occupancy, centre_cell, 0, *KITTI) == []


def test_what_came_into_sight_does_not_move() -> None:
    occupancy, centre_cell = window()
    occupancy[:4] = 0.5
    assert movers(occupancy, centre_cell, 8, *KITTI) == []


def test_sizes_are_metres_and_times_seconds() -> None:
    """A car of 1 m x 1 m at 1/3 m; were a cell 1 m wide, it would be a house, and were it 5 cm, noise."""
    occupancy, centre_cell = window()
    assert movers(occupancy, centre_cell, 8, resolution=1.5, period=0.1) == []
    assert movers(occupancy, centre_cell, 8, resolution=0.05, period=0.1) == []
    assert movers(occupancy, centre_cell, 8, resolution=0.25, period=0.1) == []  # within 3 m: of the ego itself
    (half,) = movers(occupancy, centre_cell, 8, resolution=0.5, period=0.1)
    assert half.radius == pytest.approx(1 + 2)  # one cell from its centre, and a metre
    # At 5 Hz half a second is two frames: the frame before frame 6 that is looked at is that at 4, not at 1.
    occupancy[:4] = 0.5
    assert movers(occupancy, centre_cell, 6, *KITTI) == []
    assert len(movers(occupancy, centre_cell, 6, resolution=1 / 3, period=0.2)) == 1
