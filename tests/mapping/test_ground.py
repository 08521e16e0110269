"""Ground segmentation: steps, ramps and slips by hand, a plain oracle of the random field, planes by sampling."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from envpred.mapping.geometry import GridSpec
from envpred.mapping.ground import GroundSegmenter, MarkovRandomField, RansacPlane

ROAD = -1.73
REACH = GridSpec().reach
FIELD = MarkovRandomField()
Heights = dict[tuple[int, int], list[float]]


def points_of(cells: Heights) -> NDArray[np.float32]:
    """Points at the centres of cells of 0.4 m, at the heights that are given for each."""
    return np.array([(0.4 * i, 0.4 * j, z, 0) for (i, j), heights in cells.items() for z in heights], np.float32)


def obstacle_cells(cells: Heights, sensor_height: float = 1.73) -> set[tuple[int, int]]:
    """Cells whose points are obstacles; a cell's points always share their verdict."""
    verdict = FIELD.obstacles(points_of(cells), REACH, sensor_height)
    owners = [cell for cell, heights in cells.items() for _ in heights]
    found = {cell for cell, obstacle in zip(owners, verdict, strict=True) if obstacle}
    assert found.isdisjoint(cell for cell, obstacle in zip(owners, verdict, strict=True) if not obstacle)
    return found


def road(reach: int = 6) -> Heights:
    """Flat road all around."""
    return {(i, j): [ROAD] for i in range(-reach, reach + 1) for j in range(-reach, reach + 1)}


@pytest.mark.parametrize(("rise", "obstacle"), [(0.29, False), (0.31, True)])
def test_a_step_up_is_an_obstacle_from_30_cm_on(rise: float, obstacle: bool) -> None:
    assert obstacle_cells(road() | {(3, 1): [ROAD + rise]}) == ({(3, 1)} if obstacle else set())


@pytest.mark.parametrize(("span", "obstacle"), [(0.29, False), (0.31, True)])
def test_points_of_one_cell_may_span_less_than_30_cm(span: float, obstacle: bool) -> None:
    # Downwards, so that the rise above the neighbours says nothing.
    assert obstacle_cells(road() | {(3, 1): [ROAD, ROAD - span]}) == ({(3, 1)} if obstacle else set())


def test_all_points_of_an_obstacle_cell_are_obstacles() -> None:
    verdict = FIELD.obstacles(points_of(road() | {(2, 2): [ROAD, ROAD + 0.1, ROAD + 1.0]}), REACH)
    assert np.count_nonzero(verdict) == 3


@pytest.mark.parametrize("rise", [0.29, -0.29, -2.0])
def test_a_ramp_is_ground_up_to_any_height_and_ground_may_fall_away(rise: float) -> None:
    ramp = {(i, j): [ROAD + rise * max(abs(i), abs(j))] for i in range(-12, 13) for j in range(-12, 13)}
    assert obstacle_cells(ramp) == set()


def test_a_ramp_of_31_cm_a_cell_is_an_obstacle_from_its_foot_on() -> None:
    ramp = {(i, 0): [ROAD + 0.31 * i] for i in range(1, 6)}
    assert obstacle_cells(road() | ramp) == set(ramp)


def test_behind_an_obstacle_the_ground_goes_on_at_the_height_before_it() -> None:
    wall = {(3, j): [ROAD, ROAD + 2.0] for j in range(-6, 7)}
    assert obstacle_cells(road() | wall) == {(3, j) for j in range(-6, 7)}
    # An empty cell hands on the height too: 0.2 m above the road two cells behind is still ground, 0.4 m is not.
    sparse: Heights = {(0, 0): [ROAD], (1, 0): [ROAD], (5, 0): [ROAD + 0.2], (7, 0): [ROAD + 0.2 + 0.4]}
    assert obstacle_cells(sparse) == {(7, 0)}


def test_the_highest_neighbour_of_the_previous_ring_counts_corners_too() -> None:
    slope: Heights = road() | {(1, 1): [ROAD + 0.25], (2, 2): [ROAD + 0.5]}
    assert obstacle_cells(slope) == set()
    # (3, 3) touches the previous ring only at (2, 2); (2, 0) touches (1, 1), but (2, -1) does not.
    assert obstacle_cells(slope | {(3, 3): [ROAD + 0.75]}) == set()
    assert obstacle_cells(slope | {(2, 0): [ROAD + 0.5]}) == set()
    assert obstacle_cells(slope | {(2, -1): [ROAD + 0.5]}) == {(2, -1)}


def test_neighbours_in_the_same_or_the_next_ring_do_not_count() -> None:
    # A rise of 0.25 m a cell towards (3, 0) from outside: nothing of it touches the ring inside.
    assert obstacle_cells(road() | {(3, 1): [ROAD + 0.25], (3, 0): [ROAD + 0.5]}) == {(3, 0)}
    assert obstacle_cells(road() | {(4, 0): [ROAD + 0.25], (3, 0): [ROAD + 0.5]}) == {(3, 0)}


def test_only_touching_cells_count_not_whole_rows() -> None:
    # The maximum over all of row i = 2 would be (2, 2)'s height and call (3, 0) ground.
    slope = {(1, 1): [ROAD + 0.25], (2, 2): [ROAD + 0.5]}
    assert obstacle_cells(road() | slope | {(3, 0): [ROAD + 0.55]}) == {(3, 0)}


def test_the_centre_cell_is_never_an_obstacle_and_its_highest_point_is_the_ground() -> None:
    assert obstacle_cells({(0, 0): [-1.0, 1.0], (1, 0): [1.29], (0, 1): [1.31]}) == {(0, 1)}


def test_an_empty_centre_cell_is_at_the_road_below_the_sensor() -> None:
    assert obstacle_cells({(1, 0): [ROAD + 0.29], (0, 1): [ROAD + 0.31]}) == {(0, 1)}
    assert obstacle_cells({(1, 0): [-0.71]}, sensor_height=1.0) == set()


def test_points_out_of_reach_or_too_high_take_no_part() -> None:
    assert pytest.approx(31.584, abs=1e-3) == REACH
    far = np.array(
        [
            [-31.58, -31.58, 0, 0],
            [31.59, 0, 0, 0],
            [0, -31.59, 0, 0],
            [31.58, 31.58, 0, 0],
            [5, 5, 3.51, 0],
            [5, 5, ROAD, 0],
            [9, 5, 3.49, 0],
        ],
        np.float32,
    )
    # The point at 3.51 m leaves its cell with the one on the road, which is ground.
    assert FIELD.obstacles(far, REACH).tolist() == [True, False, False, True, False, False, True]


def test_what_is_not_a_number_takes_no_part() -> None:
    broken = np.array([[np.nan, 0, 0, 0], [1, np.nan, 0, 0], [1, 1, np.nan, 0], [np.inf, 0, 0, 0]], np.float32)
    for segmenter in (FIELD, RansacPlane()):
        assert not segmenter.obstacles(broken, REACH, context_reach=60.0).any()
    assert FIELD.obstacles(np.zeros((0, 4), np.float32), REACH).shape == (0,)


def plain_field(
    points: list[tuple[float, float, float]], field: MarkovRandomField, reach: float, sensor_height: float
) -> list[bool]:
    """The random field word by word: dictionaries of cells, whole rings, explicit neighbourhoods."""
    half = math.ceil(reach / field.cell)
    cell_of: list[tuple[int, int] | None] = []
    heights: Heights = {}
    for x, y, z in points:
        inside = max(abs(x), abs(y)) <= reach and z <= field.ceiling
        cell_of.append((round(x / field.cell), round(y / field.cell)) if inside else None)
        if cell := cell_of[-1]:
            heights.setdefault(cell, []).append(z)
    ground = {(0, 0): max(heights.get((0, 0), [-sensor_height]))}
    obstacles = set()
    for radius in range(1, half + 1):
        span = range(-radius, radius + 1)
        for cell in [(i, j) for i in span for j in span if max(abs(i), abs(j)) == radius]:
            around = [(cell[0] + di, cell[1] + dj) for di in (-1, 0, 1) for dj in (-1, 0, 1)]
            before = max(ground[n] for n in around if max(map(abs, n)) == radius - 1)
            seen = heights.get(cell, [])
            if seen and max(seen) - min(seen) < field.max_span and max(seen) - before < field.max_rise:
                ground[cell] = max(seen)
            else:
                ground[cell] = before
                obstacles.update([cell] if seen else [])
    return [cell in obstacles for cell in cell_of]


# Sixteenths of a metre are exact in float32, as are their differences.
coordinate = st.integers(-40, 40).map(lambda n: n / 16)
height = st.integers(-30, -20).map(lambda n: n / 16)


@settings(max_examples=150, deadline=None)
@given(st.lists(st.tuples(coordinate, coordinate, height), min_size=1, max_size=120))
def test_the_random_field_equals_its_plain_oracle(points: list[tuple[float, float, float]]) -> None:
    field = MarkovRandomField(ceiling=-1.3)
    found = field.obstacles(np.array(points, np.float32), 2.25, 1.6)
    assert found.tolist() == plain_field(points, field, 2.25, 1.6)


# Around the reach, which ends within a ring: one of 0.4 m begins at 1.4 m, one of 1 m at 1.5 m.
near_reach = st.sampled_from([-1.625, -1.5, -1.4375, 0.0, 0.125, 1.4375, 1.5, 1.5625, 1.75, 2.125])


@settings(max_examples=150, deadline=None)
@given(
    st.lists(st.tuples(near_reach, near_reach, height), min_size=1, max_size=60),
    st.sampled_from([MarkovRandomField(), MarkovRandomField(cell=1.0), RansacPlane(trials=5)]),
    st.sampled_from([1.3125, 1.4375, 1.5, 1.5625]),
    st.sampled_from([1.625, 2.25]),
)
def test_what_lies_further_out_has_no_say(
    points: list[tuple[float, float, float]], segmenter: GroundSegmenter, reach: float, context_reach: float
) -> None:
    scan = np.array(points, np.float32)
    both = segmenter.obstacles(scan, reach, context_reach=context_reach)
    distance = np.abs(scan[:, :2]).max(axis=1)
    np.testing.assert_array_equal(both & (distance <= reach), segmenter.obstacles(scan, reach))
    assert not both[distance > context_reach].any()


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("reach", [1.4375, 1.3125])
def test_a_ring_that_the_reach_ends_in_holds_what_lies_within(axis: int, side: int, reach: float) -> None:
    scan = np.zeros((2, 4), np.float32)
    scan[:, axis] = side * reach, side * (reach + 0.0625)
    scan[:, 2] = ROAD, ROAD + 0.5
    assert FIELD.obstacles(scan, reach).tolist() == [False, False]
    assert FIELD.obstacles(scan, reach, context_reach=2.25).tolist() == [False, True]


@pytest.mark.parametrize("segmenter", [FIELD, RansacPlane()])
def test_a_wall_beyond_the_judged_grid_is_an_obstacle_to_the_wider_one(segmenter: GroundSegmenter) -> None:
    x, y = np.meshgrid(np.arange(-40, 40, 0.4), np.arange(-40, 40, 0.4))
    flat = np.stack([x.ravel(), y.ravel(), np.full(x.size, ROAD), 0 * x.ravel()], axis=1)
    for distance in (36.0, 31.7, -31.7):  # the last two lie between reach and the end of the ring it is in
        wall = np.array([[distance, y, z, 0] for y in np.arange(-5, 5, 0.2) for z in (-1.2, -0.5, 0.3)])
        scan = np.concatenate([flat, wall]).astype(np.float32)
        alone, both = (segmenter.obstacles(scan, REACH, context_reach=r) for r in (None, GridSpec(256).reach))
        assert not alone.any()
        assert both[len(flat) :].all()


def tilted_scene() -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """A road that rises by 5 cm a metre, and boxes on it."""
    random = np.random.default_rng(5)
    on_road = random.uniform(-25, 25, (4000, 4))
    on_road[:, 2] = 0.05 * on_road[:, 0] - 1.7 + random.uniform(-0.05, 0.05, len(on_road))
    boxes = random.uniform(-20, 20, (600, 4))
    boxes[:, 2] = 0.05 * boxes[:, 0] - 1.7 + random.uniform(0.5, 2, len(boxes))
    return np.concatenate([on_road, boxes]).astype(np.float32), np.arange(4600) >= 4000


def test_one_plane_fits_a_tilted_road() -> None:
    points, obstacle = tilted_scene()
    assert (RansacPlane().obstacles(points, REACH) == obstacle).all()


def test_one_seed_gives_one_plane() -> None:
    points, _ = tilted_scene()
    one, again, other = (RansacPlane(distance=0.01, trials=5, seed=s).obstacles(points, REACH) for s in (1, 1, 2))
    assert (one == again).all()
    assert (one != other).any()


def test_points_farther_from_the_plane_than_its_distance_are_obstacles_on_both_sides() -> None:
    x, y = np.meshgrid(np.arange(-9.0, 10), np.arange(-9.0, 10))
    flat = np.stack([x.ravel(), y.ravel(), np.full(x.size, -1.7), 0 * x.ravel()], axis=1)
    odd = np.array([[0.5, 0.5, -1.7 + d, 0] for d in (-0.21, -0.19, 0.19, 0.21)])
    verdict = RansacPlane(seed=1).obstacles(np.concatenate([flat, odd]).astype(np.float32), REACH)
    assert verdict[-4:].tolist() == [True, False, False, True]
    assert not verdict[:-4].any()


def test_a_facade_is_not_taken_for_the_road() -> None:
    facade = np.random.default_rng(0).uniform(-1, 1, (500, 4)).astype(np.float32)
    facade[:, 2] = 2 * facade[:, 0]  # 63 degrees steep
    facade[0] = [0, 0, 3.6, 0]  # too high to take part
    facade[1] = [40, 6, 0, 0]  # out of reach
    assert RansacPlane().obstacles(facade, REACH).tolist() == [False, False, *[True] * 498]
    assert not RansacPlane(max_tilt=70.0).obstacles(facade, REACH).any()


def test_two_points_make_no_plane() -> None:
    assert RansacPlane().obstacles(np.ones((2, 4), np.float32), REACH).tolist() == [False, False]
