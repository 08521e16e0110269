"""Measuring the future again: a static world cell by cell against the mapping, and worlds worked out by hand."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from envpred.datamodules import symmetry
from envpred.errors import UserError
from envpred.mapping.evidence import accumulate, pignistic
from envpred.mapping.geometry import FloatArray, GridSpec
from envpred.mapping.label_grid import RayCasting
from envpred.mapping.movers import Movers
from envpred.mapping.rollout import Rollout, Scene
from envpred.mapping.world import World, label_world

SPEC = GridSpec(64)
CONTEXT = 128
SENSOR = (0.81, -0.32)
ORIGIN = np.array([-50.0, 30.0])
Grid = NDArray[np.float32]


def drive(frames: int, turn: float, speed: float = 9.0) -> FloatArray:
    """Body poses (T, 3) in cells and radians: a circle that does not hit cells' centres."""
    heading = 0.3 + turn * np.arange(frames)
    chords = np.exp(1j * (heading + turn / 2)) * speed * 0.1 / SPEC.resolution
    places = 200.3 - 90.7j + np.concatenate([[0], np.cumsum(chords[:-1])])
    return np.stack([places.real, places.imag, heading], axis=1)


def measured(obstacles: FloatArray, poses: FloatArray, spec: GridSpec) -> tuple[NDArray[np.uint8], NDArray[np.int32]]:
    """What the mapping measures of obstacle points (M, 2), in metres of the world, along `poses`."""
    centres = np.floor(poses[:, :2] + 0.5).astype(np.int32)
    labels = np.empty((len(poses), spec.cells, spec.cells), np.uint8)
    for t, (x, y, heading) in enumerate(poses):
        pose = np.eye(4)
        pose[:2, :2] = [[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]]
        pose[:2, 3] = ORIGIN + np.array([x, y]) * spec.resolution + pose[:2, :2] @ SENSOR
        points = np.zeros((len(obstacles), 4), np.float32)
        points[:, :2] = (obstacles - pose[:2, 3]) @ pose[:2, :2]
        labels[t] = RayCasting().label(points, np.ones(len(points), np.bool_), pose, centres[t], ORIGIN, spec)
    return labels, centres


@pytest.mark.parametrize(("turn", "seed"), [(0.0, 0), (0.04, 1), (-0.1, 2)])
def test_a_static_world_is_measured_as_the_mapping_measures_it(turn: float, seed: int) -> None:
    """Obstacles at the centres of cells, off the ego's way: labels, masses and forecasts of 12 frames, cell by cell."""
    random = np.random.default_rng(seed)
    poses = drive(17, turn)
    cells = poses[4, :2].round() + random.integers(-60, 60, (400, 2))
    near = np.abs(cells[:, None] - poses[None, :, :2]).max(axis=2).min(axis=1) < 11
    obstacles = ORIGIN + cells[~near] * SPEC.resolution
    labels, centres = measured(obstacles, poses, SPEC)
    mass = accumulate(labels, centres)
    wide, _ = measured(obstacles, poses[4:5], GridSpec(CONTEXT))
    world = label_world(wide[0], 1.0)
    found = Rollout(SENSOR, grid=SPEC).expected(Scene(mass[4], world, centres[4], poses[None, 5:]))
    assert np.abs(found - pignistic(mass[5:])).max() < 2e-6
    drawn = Rollout(SENSOR, grid=SPEC).samples(Scene(mass[4], world, centres[4], poses[None, 5:]), random)
    assert (drawn[0] == found).all(), "nothing is left to chance in a world of 0 and 1"
    still = pignistic(mass[4])
    assert np.abs(still - pignistic(mass[-1])).max() > 0.9, "a drive on which things change"


def still(frames: int, x: float = 0.0, y: float = 0.0, heading: float = 0.0) -> FloatArray:
    """A future (1, N, 3) of an ego that stands at a place of the lattice."""
    return np.tile([x, y, heading], (1, frames, 1))


SMALL = GridSpec(16)
TINY_EGO = (-0.1, 0.1, 0.1)  # a body within the sensor's cell and its neighbours


def small(**changes: Any) -> Rollout:
    return Rollout((0.0, 0.0), grid=SMALL, body=TINY_EGO, **changes)


def hits(cells: dict[tuple[int, int], float], size: int = 16, horizons: int = 1) -> World:
    """A world of hit probabilities at cells counted from the centre cell."""
    world = np.zeros((horizons, size, size), np.float32)
    for (i, j), probability in cells.items():
        world[:, i + size // 2, j + size // 2] = probability
    return World(world)


NOTHING = np.zeros((2, 16, 16), np.float32)
ORIGIN_CELL = np.zeros(2, np.int32)
SEEN_FREE, SEEN_OCCUPIED = 0.025, 0.975


def test_a_wall_with_a_gap_that_may_be_closed() -> None:
    """Wall at x = 4 from y = -3 to 3; its middle cell is hit every fourth time."""
    wall = {(4, j): 1.0 for j in range(-3, 4)}
    found = small(clump=0.0).expected(Scene(NOTHING, hits({**wall, (4, 0): 0.25}), ORIGIN_CELL, still(1)))[0]
    assert found[8 + 4, 8 + 1] == pytest.approx(SEEN_OCCUPIED)
    assert found[8 + 3, 8] == pytest.approx(SEEN_FREE)
    # The gap: q = 0.25 occupied, else free: m = (0.25 x 0.95, 0.75 x 0.95).
    assert found[8 + 4, 8] == pytest.approx(0.5 + 0.5 * (0.25 - 0.75) * 0.95)
    # Behind it T = 0.75: free with 0.75, else not measured; m = (0, 0.75 x 0.95).
    assert found[8 + 6, 8] == pytest.approx(0.5 - 0.5 * 0.75 * 0.95)
    # Behind the wall: not measured.
    assert found[8 + 6, 8 + 2] == pytest.approx(0.5)
    # With clump c a cell stops rays with q^2 / (q + c (1 - q)): 0.0625 / 0.625 = 0.1.
    found = small(clump=0.5).expected(Scene(NOTHING, hits({**wall, (4, 0): 0.25}), ORIGIN_CELL, still(1)))[0]
    assert found[8 + 6, 8] == pytest.approx(0.5 - 0.5 * 0.9 * 0.95)
    assert found[8 + 6, 8 + 2] == pytest.approx(0.5), "a sure hit stops all"


def test_evidence_of_the_past_ages_and_is_fused() -> None:
    """m' = q fuse(m, occupied) + (1 - q) T fuse(m, free), with m = (0.6, 0.3) aged to (0.54, 0.27)."""
    mass = NOTHING.copy()
    mass[:, 8 + 4, 8] = 0.6, 0.3
    found = small().expected(Scene(mass, hits({(4, 0): 0.25}), ORIGIN_CELL, still(1)))[0, 8 + 4, 8]
    o, f, u = 0.54, 0.27, 0.19
    agreed = 1 - 0.95 * f, 1 - 0.95 * o
    occupied = 0.25 * (o + 0.95 * u) / agreed[0] + 0.75 * o * 0.05 / agreed[1]
    free = 0.25 * f * 0.05 / agreed[0] + 0.75 * (f + 0.95 * u) / agreed[1]
    assert found == pytest.approx(0.5 + 0.5 * (occupied - free), abs=1e-6)


def test_an_ego_that_turns_and_drives_looks_from_where_it_is() -> None:
    """The sensor is 1 m ahead of the body; turned to the north it is 3 cells north of it."""
    ahead = Rollout((1.0, 0.0), grid=SMALL, body=TINY_EGO)
    future = np.array([[[2.0, 0.0, np.pi / 2]]])
    found = ahead.expected(Scene(NOTHING, hits({(2, 5): 1.0}, 32), ORIGIN_CELL, future))[0]
    # The grid's centre cell is (2, 0): the hit at (2, 5) lies at (0, 5) in it, the sensor at (0, 3).
    assert found[8, 8 + 5] == pytest.approx(SEEN_OCCUPIED)
    assert found[8, 8 + 4] == pytest.approx(1.0), "within a cell of the body"
    assert found[8, 8 + 6] == pytest.approx(0.5), "in the shadow"
    assert found[8, 8 - 3] == pytest.approx(SEEN_FREE)


def test_cells_that_enter_carry_no_mass_and_others_keep_theirs() -> None:
    mass = NOTHING.copy()
    mass[0] = 0.5
    wall = hits({(i, j): 1.0 for i in range(-3, 8) for j in (-2, 2)}, 32)
    future = np.array([[[2.0, 0.0, 0.0]]])
    found = small().expected(Scene(mass, wall, ORIGIN_CELL, future))[0]
    assert found[8, 8 + 6] == pytest.approx(0.5 + 0.25 * 0.9), "in the shadow: aged"
    assert found[15, 15] == pytest.approx(0.5), "in the shadow, and new: 15 was beyond the grid before"


def test_a_mover_crosses_uncovers_and_hides() -> None:
    """From (4, -4) north at a cell a frame: it is at (4, -3 + h), shades what is behind, and leaves free cells."""
    movers = Movers(
        cell=np.array([[4, -4]]),
        velocity=np.array([[0.0, 1 / 3 / 0.1]], np.float32),
        deviation=np.array([[0.0, 0.0, 1 / 3 / 0.1]], np.float32),
        hit=np.full((1, 5), 1.0, np.float32),
    )
    rollout = small()
    found = rollout.expected(Scene(NOTHING, hits({}), ORIGIN_CELL, still(5), movers))
    # Seen free once, m(F) = 0.95 ages to 0.855; then hit: (0.145 x 0.95, 0.855 x 0.05) / (1 - 0.855 x 0.95).
    assert found[0, 8 + 4, 8 - 3] == pytest.approx(SEEN_OCCUPIED)
    assert found[1, 8 + 4, 8 - 2] == pytest.approx(0.5 + 0.5 * (0.13775 - 0.04275) / 0.18775)
    for h in range(5):
        assert np.argmax(found[h, 8 + 4]) == 8 - 3 + h
        assert found[h, 8 + 4, 8 - 4] < 0.1, "uncovered"
    assert found[0, 8 + 6, 8 - 5] == pytest.approx(0.5), "hidden behind it at first"
    assert found[1, 8 + 6, 8 - 5] < 0.1, "and not any more"
    assert found[3, 8 + 6, 8] > found[2, 8 + 6, 8], "when it comes between, the evidence of free fades"
    # Drawn one deviation faster it goes twice as far, one deviation slower it stands.
    draws = np.array([[0.0, 1.0], [0.0, -1.0]])
    both = rollout.expected(Scene(NOTHING, hits({}), ORIGIN_CELL, np.repeat(still(5), 2, axis=0), movers, draws))
    assert both[0, 8 + 4, [8 - 4, 8 - 3, 8 - 2]] == pytest.approx([0.5, SEEN_FREE, 0.5], abs=1e-3)
    assert both[2, 8 + 4, 8 - 4] == pytest.approx(0.5, abs=0.02), "free or occupied three times"
    assert both[2, 8 + 4, 8 + 2] == pytest.approx((0.68 + 0.01) / 2, abs=0.03)


def test_where_the_ego_stands_the_last_frame_is_remembered() -> None:
    """Half of the forecast; of a cell that rays do not reach, what was seen from here before is seen again."""
    wall = {(4, j): 1.0 for j in range(-3, 4)}
    seen = np.full((1, 16, 16), 0.8, np.float32)
    world = World(hits(wall).hit, seen, (0.0, 0.0), near=1.0)
    mass = NOTHING.copy()
    mass[0, 8 + 6, 8] = 0.5
    alone = small(remembered=0.0).expected(Scene(mass, world, ORIGIN_CELL, still(1)))[0, 8 + 6, 8]
    # Aged to 0.45; with 0.8 fused with free: (0.45 x 0.05, 0.55 x 0.95) / (1 - 0.45 x 0.95).
    k = 1 - 0.45 * 0.95
    expected = 0.5 + 0.5 * (0.8 * (0.45 * 0.05 - 0.55 * 0.95) / k + 0.2 * 0.45)
    assert alone == pytest.approx(expected, abs=1e-6)
    half = small(remembered=0.5).expected(Scene(mass, world, ORIGIN_CELL, still(1)))[0, 8 + 6, 8]
    assert half == pytest.approx((expected + 0.75) / 2, abs=1e-6)
    away = small(remembered=0.5).expected(Scene(mass, replace(world, place=(-9.0, 0.0)), ORIGIN_CELL, still(1)))[
        0, 8 + 6, 8
    ]
    assert away == pytest.approx(0.5 + 0.5 * 0.45), "from 3 m away nothing of that counts"


def test_futures_are_averaged_and_equal_ones_measured_once() -> None:
    random = np.random.default_rng(0)
    world = World(random.random((1, 64, 64)).astype(np.float32) * (random.random((1, 64, 64)) < 0.2))
    mass = (random.dirichlet((1, 1, 2), (16, 16)).transpose(2, 0, 1)[:2]).astype(np.float32)
    futures = np.cumsum(random.uniform(-1, 1, (6, 4, 3)), axis=1).astype(np.float64)
    every = [small().expected(Scene(mass, world, ORIGIN_CELL, future[None])) for future in futures]
    together = small().expected(Scene(mass, world, ORIGIN_CELL, futures))
    assert together == pytest.approx(np.mean(every, axis=0), abs=1e-6)
    repeated = small().expected(Scene(mass, world, ORIGIN_CELL, futures[[0, 1, 0, 0]]))
    assert repeated == pytest.approx(0.75 * every[0] + 0.25 * every[1], abs=1e-6)
    with ThreadPoolExecutor(2) as pool:
        assert (small().expected(Scene(mass, world, ORIGIN_CELL, futures), mapper=pool.map) == together).all()
    beyond = small(beyond=0.0).expected(Scene(mass, World(world.hit[:, 24:40, 24:40]), ORIGIN_CELL, futures))
    padded = np.zeros_like(world.hit)
    padded[:, 24:40, 24:40] = world.hit[:, 24:40, 24:40]
    assert (beyond == small().expected(Scene(mass, World(padded), ORIGIN_CELL, futures))).all()


def test_the_mean_of_samples_is_near_the_closed_form() -> None:
    random = np.random.default_rng(1)
    hit = (random.random((3, 32, 32)) * (random.random((3, 32, 32)) < 0.15)).astype(np.float32)
    mass = random.dirichlet((1, 1, 3), (16, 16)).transpose(2, 0, 1)[:2].astype(np.float32)
    futures = np.repeat(still(3, 0.3, -0.2), 3000, axis=0)
    rollout = small()
    closed = rollout.expected(Scene(mass, World(hit), ORIGIN_CELL, futures))
    drawn = rollout.samples(Scene(mass, World(hit), ORIGIN_CELL, futures), random)
    assert drawn.shape == (3000, 3, 16, 16)
    # Exact after one step, but for the largest of several rays: that of a mean is less than the mean of that.
    assert np.abs(drawn.mean(axis=0) - closed)[0].mean() < 0.01
    assert np.abs(drawn.mean(axis=0) - closed).mean() < 0.03
    assert drawn.std(axis=0).max() > 0.3
    again = rollout.samples(Scene(mass, World(hit), ORIGIN_CELL, futures[:4]), np.random.default_rng(5))
    assert (again == rollout.samples(Scene(mass, World(hit), ORIGIN_CELL, futures[:4]), np.random.default_rng(5))).all()
    assert (again[0] != again[1]).any()


scenes = st.tuples(st.integers(0, 2**31), st.integers(1, 7))


@settings(max_examples=25, deadline=None)
@given(scenes)
def test_forecasts_are_probabilities_and_turn_with_the_world(scene: tuple[int, int]) -> None:
    """The eight symmetries: world, masses and futures turned give the forecast turned."""
    seed, turn = scene
    random = np.random.default_rng(seed)
    hit = (random.random((2, 32, 32)) * (random.random((2, 32, 32)) < 0.2)).astype(np.float32)
    mass = random.dirichlet((1, 1, 1), (16, 16)).transpose(2, 0, 1)[:2].astype(np.float32)
    futures = np.concatenate([random.uniform(-5, 5, (2, 2, 2)), random.uniform(-3, 3, (2, 2, 1))], axis=2)
    rollout = Rollout((0.4, -0.3), 0.1, SMALL, (-0.4, 0.9, 0.3), remembered=float(random.random()))
    seen = random.random((1, 32, 32)).astype(np.float32)
    place = np.array([0.3, 0.1])
    found = rollout.expected(Scene(mass, World(hit, seen, (0.3, 0.1), 2.0), ORIGIN_CELL, futures))
    assert ((found >= 0) & (found <= 1)).all()
    if turn.bit_count() % 2:
        rollout = rollout.mirrored()
    east, north = symmetry.turn_vector(place, turn).tolist()
    world = World(symmetry.turn_grid(hit, turn), symmetry.turn_grid(seen, turn), (east, north), 2.0)
    centre = symmetry.turn_cell(ORIGIN_CELL, turn)
    turned = symmetry.turn_pose(futures, turn).astype(np.float64)
    offset = int(centre[0]), int(centre[1])
    other = rollout.expected(Scene(symmetry.turn_grid(mass, turn), world, centre, turned), offset=offset)
    # Rays to the middles of border cells are the same; a tie between two cells is broken another way.
    assert (np.abs(other - symmetry.turn_grid(found, turn)) > 1e-4).mean() < 0.01


@pytest.mark.parametrize(
    ("future", "size", "message"),
    [
        (still(1), 14, "smaller than the judged grid of 16"),
        (still(1, 8.6), 32, r"leaves the context of 32 cells by 0\.3 m within 0\.1 s; give a context of 34 cells"),
        (still(1, 0, -9), 32, r"leaves the context of 32 cells by 0\.3 m"),
        (np.full((1, 1, 3), np.nan), 32, "not finite"),
    ],
)
def test_what_cannot_be_measured_is_refused(future: FloatArray, size: int, message: str) -> None:
    with pytest.raises(UserError, match=message):
        small().expected(Scene(NOTHING, hits({}, size), ORIGIN_CELL, future))


def test_shapes_that_do_not_belong_together_are_refused() -> None:
    with pytest.raises(ValueError, match=r"\(K, N, 3\)"):
        small().expected(Scene(NOTHING, hits({}), ORIGIN_CELL, still(1)[0]))
    with pytest.raises(ValueError, match="masses"):
        small().expected(Scene(NOTHING[:, :8], hits({}), ORIGIN_CELL, still(1)))
    with pytest.raises(ValueError, match="contexts"):
        small().expected(Scene(NOTHING, hits({}, horizons=2), ORIGIN_CELL, still(3)))
    with pytest.raises(UserError, match="sensor"):
        Rollout((3.0, 0.0), grid=SMALL)


def test_the_body_lies_in_the_frame_of_the_sensor_that_is_turned_in_it() -> None:
    """A body 1 m ahead of the sensor; the sensor looks to the body's left, so its ahead is north."""
    turned = Rollout((0.0, 0.0), np.pi / 2, SMALL, (0.0, 1.0, 0.0))
    found = turned.expected(Scene(NOTHING, hits({}), ORIGIN_CELL, still(1)))[0]
    assert found[8, 8 + 4] == found[8, 8 + 3] == pytest.approx(1.0)
    assert found[8 + 3, 8] == pytest.approx(SEEN_FREE)
