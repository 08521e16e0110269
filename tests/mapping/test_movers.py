"""What is taken out of the world as moving, and where it goes."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from envpred.cli.commands import grids
from envpred.cli.own import parsed
from envpred.errors import UserError
from envpred.mapping.geometry import FREE, OCCUPIED
from envpred.mapping.movers import Moving, carried_on
from envpred.mapping.world import World
from tests.remedies import remedy

CENTRE = np.array([100, -50])


def scene() -> tuple[World, np.ndarray, np.ndarray, np.ndarray]:
    """A world (1, 16, 16) hit everywhere with 0.5, label (8, 8), velocities and covariances; cell (3, 5) moves."""
    label = np.full((8, 8), FREE, np.uint8)
    label[3, 5] = label[3, 6] = OCCUPIED
    velocity, covariance = np.zeros((2, 8, 8)), np.zeros((3, 8, 8))
    covariance[[0, 2]] = 1.0
    velocity[:, 3, 5] = 3.0, -4.0
    covariance[:, 3, 5] = 4.0, 2.0, 5.0  # Cholesky: 2, 1, 2
    return World(np.full((1, 16, 16), 0.5, np.float32)), label, velocity, covariance


def test_what_moves_leaves_with_its_trail() -> None:
    world, label, velocity, covariance = scene()
    rest, movers = Moving(share=0.8, trail=1, spread=0.5).split(world, label, velocity, covariance, CENTRE, 3, "ground")
    gone = np.argwhere(rest.hit[0] < 0.5)
    # Label cell (3, 5) is (7, 9) of the context; its neighbour (7, 10) is occupied and stands.
    expected = [[i, j] for i in (6, 7, 8) for j in (8, 9, 10) if (i, j) != (7, 10)]
    assert gone.tolist() == expected
    assert rest.hit[0, 7, 9] == pytest.approx(0.1)
    assert (world.hit == 0.5).all(), "the world that was given stays"
    assert movers.cell.tolist() == [[100 - 4 + 3, -50 - 4 + 5]]
    assert movers.velocity.tolist() == [[3.0, -4.0]]
    assert movers.deviation == pytest.approx(np.array([[1.0, 0.5, 1.0]]))
    assert movers.hit == pytest.approx(np.array([[0.75, 0.75 * 0.98, 0.75 * 0.98**2]]))


def test_movers_go_where_their_velocity_carries_them() -> None:
    world, label, velocity, covariance = scene()
    _, movers = Moving(spread=1.0).split(world, label, velocity, covariance, CENTRE, 2, "ground")
    cells, hit = carried_on(movers, None, 2, 0.1, 0.25)
    # 3 and -4 m/s are 1.2 and -1.6 cells a frame.
    assert cells[:, 0].tolist() == [[99 + 1, -49 - 2], [99 + 2, -49 - 3]]
    assert hit.shape == (2, 1)
    # One deviation: (3 + 2, -4 + 1 + 2) m/s = (2, -0.4) cells a frame.
    cells, _ = carried_on(movers, np.array([1.0, 1.0]), 2, 0.1, 0.25)
    assert cells[:, 0].tolist() == [[101, -49], [103, -50]]
    nothing, hit = carried_on(None, None, 2, 0.1, 0.25)
    assert nothing.shape == (2, 0, 2)
    assert hit.shape == (2, 0)


@pytest.mark.parametrize(
    ("change", "moves"),
    [({}, 1), ({"slowest": 5.1}, 0), ({"tau": 8.0}, 0), ({"tau": 11.0}, 0)],
)
def test_what_counts_as_moving(change: dict[str, Any], moves: int) -> None:
    world, label, velocity, covariance = scene()
    velocity[:, 3, 5] = 3.0, 4.0  # v' P^-1 v = (5 x 9 - 2 x 2 x 12 + 4 x 16) / 16 = 3.8
    found = replace(Moving(tau=3.5), **change).split(world, label, velocity, covariance, CENTRE, 1, "ground")[1]
    assert len(found.cell) == moves
    label[3, 5] = FREE
    assert not len(Moving(tau=3.5).split(world, label, velocity, covariance, CENTRE, 1, "ground")[1].cell)


def test_velocities_relative_to_the_ego_are_refused() -> None:
    with pytest.raises(UserError, match="relative to the ego") as failure:
        Moving().split(*scene(), CENTRE, 1, "ego")
    (option,) = remedy(failure.value)
    given = parsed("grids", grids, ["--store=grids", *option])
    Moving().split(*scene(), CENTRE, 1, given["particles"].filter.frame)
