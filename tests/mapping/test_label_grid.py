"""Label grids: walls, shadows and the ego by hand; rays against fine sampling and against exact geometry."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from envpred.mapping.geometry import EGO, FREE, OCCUPIED, UNKNOWN, FloatArray, GridSpec
from envpred.mapping.label_grid import RayCasting

SPEC = GridSpec()
CENTRE = np.array([300, -20], np.int32)
ORIGIN = np.array([-50.0, 30.0])
Points = NDArray[np.float32]


def sensor_pose(heading: float = 0.0, offset: tuple[float, float] = (0.0, 0.0), spec: GridSpec = SPEC) -> FloatArray:
    """Pose of a sensor `offset` metres east and north of the middle of the centre cell."""
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]]
    pose[:2, 3] = ORIGIN + CENTRE * spec.resolution + offset
    pose[2, 3] = 2.5
    return pose


def label(
    points: list[tuple[float, ...]] | Points, pose: FloatArray, rays: RayCasting = RayCasting()
) -> NDArray[np.uint8]:
    """The label grid of obstacle points (sensor frame)."""
    array = np.zeros((len(points), 4), np.float32)
    for row, point in zip(array, points, strict=True):
        row[: len(point)] = point
    return rays.label(array, np.ones(len(array), np.bool_), pose, CENTRE, ORIGIN, SPEC)


def metres(*cells: tuple[float, float]) -> list[tuple[float, ...]]:
    """Points of cells counted from the sensor."""
    return [(i / 3, j / 3) for i, j in cells]


def test_an_empty_scan_frees_everything_but_the_ego() -> None:
    grid = label(np.zeros((0, 4), np.float32), sensor_pose())
    assert grid.dtype == np.uint8
    ego = np.zeros((128, 128), np.bool_)
    # Body -0.81 to 1.95 m and 0.8 m to each side, a cell of 1/3 m more: -3.43 to 6.85 and 3.4 cells.
    ego[64 - 3 : 64 + 7, 64 - 3 : 64 + 4] = True
    assert (grid == np.where(ego, EGO, FREE)).all()


def test_the_ego_turns_with_the_vehicle_and_moves_with_the_sensor() -> None:
    north = label([], sensor_pose(np.pi / 2))
    assert np.argwhere(north == EGO).min(axis=0).tolist() == [61, 61]
    assert np.argwhere(north == EGO).max(axis=0).tolist() == [67, 70]
    northeast = label([], sensor_pose(np.pi / 4))
    assert northeast[64 + 4, 64 + 4] == EGO, "4 sqrt(2) cells ahead"
    assert northeast[64 + 4, 64 - 4] == northeast[64 - 4, 64 + 4] == FREE, "as far to the sides"
    # 0.2 m further west: -4.03 to 6.25 cells.
    moved = label([], sensor_pose(offset=(-0.2, 0.0)))
    assert np.argwhere(moved == EGO).min(axis=0).tolist() == [60, 61]
    assert np.argwhere(moved == EGO).max(axis=0).tolist() == [70, 67]


def test_a_wall_and_its_shadow() -> None:
    grid = label(metres(*[(30, j) for j in range(-10, 11)]), sensor_pose())
    assert (grid[94, 54:75] == OCCUPIED).all()
    assert np.count_nonzero(grid == OCCUPIED) == 21
    assert (grid[71:94, 64] == FREE).all(), "before the wall"
    assert (grid[95:, 64] == UNKNOWN).all(), "behind the wall"
    # The line to the border cell (127, 64 + 20) passes the wall's column at 20 x 30 / 63 = 9.5 cells: stopped.
    # The one to (127, 64 + 25) passes it at 11.9 cells, beside the wall.
    assert grid[127, 64 + 20] == grid[127, 64 - 20] == UNKNOWN
    assert grid[127, 64 + 25] == grid[127, 64 - 25] == FREE
    assert (grid[:60] == FREE).all(), "all that lies behind the sensor"


def test_a_return_on_the_border_is_occupied_and_what_lies_outside_is_dropped() -> None:
    border = metres((63, 0), (-64, 0), (0, 63), (0, -64))
    outside = metres((63.6, 5), (-64.6, 5), (5, 63.6), (5, -64.6))
    grid = label(border + outside, sensor_pose())
    assert np.argwhere(grid == OCCUPIED).tolist() == [[0, 64], [64, 0], [64, 127], [127, 64]]


def test_a_point_lies_in_the_cell_whose_centre_is_nearest() -> None:
    grid = label(metres((20.49, 10.49), (-20.49, -10.49)), sensor_pose())
    assert np.argwhere(grid == OCCUPIED).tolist() == [[44, 54], [84, 74]]
    turned = label(metres((20.49, 10.49)), sensor_pose(np.pi / 2))  # forward is north, left is west
    assert np.argwhere(turned == OCCUPIED).tolist() == [[54, 84]]


def test_ground_points_occupy_nothing() -> None:
    points = np.array([[10, 0, -1.7, 0], [0, 10, 0, 0]], np.float32)
    grid = RayCasting().label(points, np.array([False, True]), sensor_pose(), CENTRE, ORIGIN, SPEC)
    assert np.argwhere(grid == OCCUPIED).tolist() == [[64, 94]]


def test_height_moves_a_point_sideways_where_the_vehicle_leans() -> None:
    leaning = sensor_pose()
    leaning[:3, :3] = [[0.8, 0.0, 0.6], [0.0, 1.0, 0.0], [-0.6, 0.0, 0.8]]  # pitched
    grid = label([(10.0, 5.0, 5.0)], leaning)  # 0.8 x 10 + 0.6 x 5 = 11 m east: 33 cells
    assert np.argwhere(grid == OCCUPIED).tolist() == [[64 + 33, 64 + 15]]


@pytest.mark.parametrize(
    ("point", "kept"),
    [
        # Front 0.27 + 1.68 + 0.8 + 1/6 = 2.917 m, rear -0.81 - 0.7 - 1/6 = -1.677 m, sides 0.8 + 0.7 + 1/6 = 1.667 m.
        ((2.91, 0.0), False),
        ((2.92, 0.0), True),
        ((-1.67, 0.0), False),
        ((-1.69, 0.0), True),
        ((1.0, 1.66), False),
        ((1.0, 1.68), True),
        ((1.0, -1.66), False),
        ((1.0, -1.68), True),
        ((2.91, 1.68), True),
    ],
)
@pytest.mark.parametrize("heading", [0.0, 2.0])
def test_returns_of_the_ego_itself_are_dropped(point: tuple[float, float], kept: bool, heading: float) -> None:
    grid = label([point], sensor_pose(heading))
    assert ((grid == OCCUPIED).any() or (grid == UNKNOWN).any()) == kept


@pytest.mark.parametrize(("distance", "kept"), [(0.79, False), (0.81, True)])
def test_points_nearer_than_80_cm_in_the_plane_are_dropped(distance: float, kept: bool) -> None:
    no_box = RayCasting(rear_margin=-10)
    grid = label([(0.0, distance, 3.0)], sensor_pose(1.0), no_box)
    assert (grid == UNKNOWN).any() == kept, "what is kept casts a shadow"
    assert (label([(0.0, distance, 3.0)], sensor_pose(1.0), RayCasting(rear_margin=-10, nearest=0.0)) == UNKNOWN).any()


def random_scene(seed: int) -> tuple[NDArray[np.uint8], NDArray[np.uint8], FloatArray]:
    """A label grid, the same without free space, and the sensor's place in cells of the grid."""
    random = np.random.default_rng(seed)
    offset = random.uniform(-0.9, 0.9, 2)
    points = random.uniform(-20, 20, (60, 2)).astype(np.float32)
    grid = label(points, sensor_pose(offset=(offset[0], offset[1])))
    return grid, np.where(grid == OCCUPIED, grid, 0).astype(np.uint8), 64 + 3 * offset


def border(cells: int) -> NDArray[np.int64]:
    """All border cells (N, 2)."""
    every = np.argwhere(np.ones((cells, cells), np.bool_))
    rim: NDArray[np.int64] = every[((every == 0) | (every == cells - 1)).any(axis=1)]
    return rim


@pytest.mark.parametrize("seed", range(3))
def test_free_space_agrees_with_sampling_every_hundredth_of_a_cell(seed: int) -> None:
    grid, occupied, sensor = random_scene(seed)
    expected = occupied.copy()
    targets = border(128)
    assert len(targets) == 508
    for target in targets:
        samples = int(100 * np.abs(target - sensor).max()) + 1
        along = np.floor(sensor + np.linspace(0, 1, samples)[:, None] * (target - sensor) + 0.5).astype(int)
        blocked = np.flatnonzero(occupied[along[:, 0], along[:, 1]])
        seen = along[: blocked[0] if len(blocked) else None]
        expected[seen[:, 0], seen[:, 1]] = FREE
    expected[grid == EGO] = EGO
    assert (grid == expected).mean() > 0.998
    assert (expected == UNKNOWN).mean() > 0.1, "a scene with shadows"


@settings(max_examples=25, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 15), st.integers(0, 15)), max_size=12),
    st.tuples(st.floats(5.6, 9.4), st.floats(5.6, 9.4)),
)
def test_a_cell_is_free_exactly_where_a_line_to_the_border_reaches_it(
    walls: list[tuple[int, int]], sensor: tuple[float, float]
) -> None:
    """Exact geometry as oracle: squares cut by segments; what a line only grazes may go either way."""
    spec = GridSpec(16, 0.5)
    pose = sensor_pose(spec=spec)
    pose[:2, 3] = ORIGIN + (CENTRE - 8 + np.array(sensor)) * 0.5
    points = np.array([((i - sensor[0]) * 0.5, (j - sensor[1]) * 0.5, 0, 0) for i, j in walls], np.float32)
    no_box = RayCasting(rear_margin=-10, nearest=0.0)
    grid = no_box.label(points.reshape(-1, 4), np.ones(len(walls), np.bool_), pose, CENTRE, ORIGIN, spec)
    occupied = np.zeros((16, 16), np.bool_)
    for wall in walls:
        occupied[wall] = True
    centres = np.stack(np.meshgrid(np.arange(16), np.arange(16), indexing="ij"), axis=-1)
    surely, perhaps = np.zeros((2, 16, 16), np.bool_)
    for target in border(16):
        direction = target - np.array(sensor)
        direction[direction == 0] = 1e-12
        near = (centres - sensor - 0.5 * np.sign(direction)) / direction
        far = (centres - sensor + 0.5 * np.sign(direction)) / direction
        enter, leave = np.maximum(near.max(axis=-1), 0), np.minimum(far.min(axis=-1), 1)
        crossed, touched = leave - enter > 1e-6, leave - enter > -1e-6
        surely |= crossed & ~occupied & (enter < enter[touched & occupied].min(initial=np.inf) - 1e-6)
        perhaps |= touched & ~occupied & (enter < enter[crossed & occupied].min(initial=np.inf) + 1e-6)
    elsewhere = grid != EGO
    assert (grid[surely & elsewhere] == FREE).all()
    assert perhaps[grid == FREE].all()
    assert (grid[occupied & elsewhere] == OCCUPIED).all()


def test_a_sensor_beyond_the_border_still_sees_in() -> None:
    grid = label([], sensor_pose(offset=(-22.0, 0.0)))  # 66 cells west of the centre, 2 outside
    assert set(np.unique(grid)) <= {UNKNOWN, FREE, EGO}
    assert (grid[5:, 64] == FREE).all()
