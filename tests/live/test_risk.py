"""Risk of paths that can be worked out by hand: cells of a metre, a body of two metres by one."""

import numpy as np
import pytest
from numpy.typing import NDArray

from envpred.errors import UserError
from envpred.live.risk import Risk, risk
from envpred.mapping.geometry import Body
from tests.live.forecasts import HOME, LANE, cell, empty, standing


def east(steps: int, speed: float = 2.0) -> NDArray[np.float64]:
    """A path along the lane from x = 20 to the east, a row a second."""
    time = np.arange(steps + 1.0)
    return np.stack([20 + speed * time, np.full(steps + 1, LANE), np.zeros(steps + 1), time], axis=1)


def same(found: NDArray[np.float64], wanted: list[float]) -> None:
    np.testing.assert_allclose(found, wanted, atol=1e-6)


def test_a_wall_counts_from_when_the_body_reaches_it() -> None:
    """At x = 22, 24, 26 the body covers three cells, centres x - 1 to x + 1; the wall is at x = 25, half there."""
    grids = empty(3)
    grids[:, cell(25)[0]] = 0.5
    found = risk(east(3), standing(grids))
    same(found.time, [1, 2, 3])
    same(found.least, [0, 0.5, 0.5])
    same(found.independent, [0, 0.5, 0.75])  # the same cell at two horizons
    same(found.most, [0, 0.5, 1])
    same(found.unknown, [0, 0, 0])
    assert found.samples == 0


def test_bounds_of_two_cells_at_once() -> None:
    grids = empty(1)
    grids[0][cell(22)], grids[0][cell(23)] = 0.2, 0.3
    found = risk(east(1), standing(grids))
    same(np.concatenate([found.least, found.independent, found.most]), [0.3, 1 - 0.8 * 0.7, 0.5])


def test_somebody_who_crosses_is_met_by_who_comes_then() -> None:
    """A mover is in the lane at x = 24 in the second second alone: at 2 m/s the ego is there, at 1 m/s it is not."""
    grids = empty(3)
    grids[0][cell(24, LANE - 2)], grids[1][cell(24)], grids[2][cell(24, LANE + 2)] = 0.9, 0.9, 0.9
    same(risk(east(3), standing(grids)).least, [0, 0.9, 0.9])
    same(risk(east(3, speed=1), standing(grids)).least, [0, 0, 0])


def test_a_path_that_leaves_the_grid_says_so() -> None:
    """The grid ends at x = 27.5: at x = 28 the body covers one cell of it and two beyond, at x = 30 none of it."""
    found = risk(east(6), standing(empty(6)))
    same(found.unknown, [0, 0, 0, 2 / 3, 1, 1])
    same(found.most, [0] * 6)


def test_what_was_never_seen_says_so_whatever_the_forecast_guesses() -> None:
    known = np.ones((48, 48), np.bool_)
    known[24 + 2] = False  # x = 22
    grids = empty(2)
    grids[:, cell(22)[0]] = 0.9
    found = risk(east(2), standing(grids, known=known))
    same(found.unknown, [1 / 3, 0])
    same(found.least, [0, 0])


def test_a_path_is_judged_as_far_as_it_and_the_forecast_reach() -> None:
    plan = east(3)
    assert len(risk(plan, standing(empty(5))).time) == 3
    assert len(risk(plan, standing(empty(2))).time) == 2
    plan[:, 3] *= 0.5  # it is over after 1.5 s
    same(risk(plan, standing(empty(5))).time, [1])


def test_between_rows_it_goes_straight_on_and_turns_the_short_way() -> None:
    """What lies a metre beside its middle is met unless it points east or west, a quarter of the way round."""
    grids = empty(2)
    grids[0][cell(22, LANE + 1)] = 0.3
    for end, met in ((-170, 0.0), (10, 0.3)):  # half way from 170 degrees: 180, or 90
        plan = np.array([[21, LANE, np.radians(170), 0], [23, LANE, np.radians(end), 2]])
        same(risk(plan, standing(grids)).least[:1], [met])
    plan[:, 0] -= 2  # x = 20 half way
    same(risk(plan, standing(grids)).least[:1], [0])


def test_samples_are_whole_futures() -> None:
    """Of four, one has a wall at x = 23 and 24, one at 25 and 26 in the last second alone, one is uncertain.

    The body covers x = 21 to 23 after a second, 23 to 25 after two, 25 to 27 after three.
    """
    samples = np.stack([empty(3) for _ in range(4)])
    samples[0, :, cell(23)[0] : cell(24)[0] + 1], samples[1, 2, cell(25)[0] : cell(26)[0] + 1] = 0.9, 0.9
    samples[2] = 0.7
    forecast = standing(samples.mean(axis=0), samples=samples, sample_ego=np.tile(HOME, (4, 3, 1)))
    found = risk(east(3), forecast)
    same(found.least, [0, 0.25, 0.5])
    assert found.samples == 4
    assert found.least is found.most
    same(risk(east(3), forecast, cells=1).least, [0.25, 0.25, 0.5])
    same(risk(east(3), forecast, occupied=0.6).least, [0.25, 0.5, 0.75])


def test_every_sample_lies_in_the_grids_of_its_own_ego() -> None:
    """The same cells of both grids: where the other ego has come 2 m further, they lie 2 m further east."""
    samples = np.stack([empty(3)] * 2)
    samples[:, :, cell(23)[0] : cell(24)[0] + 1, cell(23)[1]] = 1.0
    egos = np.stack([np.tile(HOME, (3, 1)), np.tile(HOME + np.array([2, 0, 0]), (3, 1))])
    forecast = standing(samples.mean(axis=0), samples=samples, sample_ego=egos)
    same(risk(east(3), forecast).least, [0, 0.5, 1.0])  # 23 and 24 after two seconds, 25 and 26 after three


def test_the_body_lies_where_its_sensor_does_and_may_be_larger() -> None:
    """The sensor sits 2 m ahead of the pose and 1 m to the left: at x = 22 the body covers x = 23 to 25, y = 21."""
    grids = empty(1)
    grids[0][cell(25, LANE + 1)] = 0.4
    same(risk(east(1), standing(grids, sensor=(2.0, 1.0, 0.0))).least, [0.4])
    same(risk(east(1), standing(grids)).least, [0])
    same(risk(east(1), standing(grids), Body(rear=-1, front=3, half_width=1)).least, [0.4])
    same(risk(east(1), standing(grids), margin=2.0).least, [0.4])


def test_a_turn_through_west_keeps_facing_west() -> None:
    """Half way from 170 to -170 degrees, at x = 22, a body of 3 m ahead of its pose covers x = 19 to 22."""
    grids = empty(2)
    grids[0][cell(20)] = 0.3
    plan = np.array([[21, LANE, np.radians(170), 0], [23, LANE, np.radians(-170), 2]])
    same(risk(plan, standing(grids), Body(rear=0, front=3, half_width=0.5)).least[:1], [0.3])


def test_the_sensors_place_turns_with_the_body() -> None:
    """Facing north, 2 m ahead and 1 m to the left of (22, 20) is (21, 22): the body covers x = 21, y = 21 to 23."""
    grids = empty(1)
    grids[0][cell(21, 22)] = 0.4
    north = east(1)
    north[:, 2] = np.pi / 2
    same(risk(north, standing(grids, sensor=(2.0, 1.0, 0.0))).most, [0.4])


@pytest.mark.parametrize(
    ("plan", "line"),
    [
        (np.zeros((3, 3)), r"rows of x, y, heading and time, all finite: \(N, 4\), not \(3, 3\)"),
        (np.zeros((0, 4)), "a plan holds rows"),
        (np.array([[0, 0, np.nan, 0]]), "all finite"),
        (np.array([[0, 0, 0, 0.0], [1, 0, 0, 2], [2, 0, 0, 2]]), "row 2 of the plan is at 2 s, no later"),
        (np.array([[0, 0, 0, 1.5], [1, 0, 0, 2]]), "lasts from 1.5 to 2 s .* misses the first horizon, 1 s"),
        (np.array([[0, 0, 0, 0], [1, 0, 0, 0.5]]), "lasts from 0 to 0.5 s"),
    ],
)
def test_what_is_no_plan_is_one_line(plan: NDArray[np.float64], line: str) -> None:
    with pytest.raises(UserError, match=line) as refused:
        risk(plan, standing(empty(3)))
    assert "\n" not in str(refused.value)


def test_risk_never_falls() -> None:
    random = np.random.default_rng(0)
    grids = random.random((6, 16, 16)).astype(np.float32) * 0.1
    found: Risk = risk(east(6, speed=1), standing(grids))
    for bound in (found.least, found.independent, found.most):
        assert (np.diff(bound) >= 0).all()
    assert (found.least <= found.independent).all()
    assert (found.independent <= found.most + 1e-12).all()
