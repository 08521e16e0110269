"""The gradient of a rollout by its world, against differences of the rollout itself."""

import numpy as np
import pytest

from envpred.mapping.geometry import GridSpec
from envpred.mapping.movers import Movers
from envpred.mapping.rollout import Rollout, Scene
from envpred.mapping.world import Grids, World

CELLS, WIDE = 16, 32
ROLLOUT = Rollout((0.2, -0.1), grid=GridSpec(CELLS), body=(-0.1, 0.1, 0.1), clump=0.1, least=0.0)
CENTRE = np.array([50, 50])


def scene(horizons: int, moving: bool, seen: bool, seed: int = 3) -> tuple[Grids, World, np.ndarray, Movers | None]:
    """Masses, a world of rather transparent cells, three futures that turn and drive, and a mover."""
    random = np.random.default_rng(seed)
    mass = random.dirichlet((1, 1, 1), size=(CELLS, CELLS)).transpose(2, 0, 1)[:2].astype(np.float32)
    hit = random.uniform(0.05, 0.6, (horizons, WIDE, WIDE)).astype(np.float32)
    steps = np.arange(1, horizons + 1)[None, :, None] * random.uniform(0.2, 1.2, (3, 1, 3)) * [1, 0.6, 0.05]
    futures = np.array([50.1, 50.2, 0.3]) + steps
    near = random.uniform(0.2, 0.9, hit.shape).astype(np.float32) if seen else None
    movers = None
    if moving:
        movers = Movers(
            cell=np.array([[53, 48], [47, 52]]),
            velocity=np.array([[0.0, 3.0], [2.0, 0.0]], np.float32),
            deviation=np.zeros((2, 3), np.float32),
            hit=np.full((2, horizons), 0.7, np.float32),
        )
    return mass, World(hit, near, (50.0, 50.0), near=0.6), futures, movers


@pytest.mark.parametrize("channels", [1, 4])
@pytest.mark.parametrize(("moving", "seen"), [(False, False), (True, False), (False, True)])
def test_the_gradient_is_that_of_differences(channels: int, moving: bool, seen: bool) -> None:
    """Along random directions and at single cells, of a random sum of what is rendered."""
    mass, world, futures, movers = scene(4, moving, seen)
    random = np.random.default_rng(9)
    by = random.normal(size=(4, channels, CELLS, CELLS)).astype(np.float32)

    def value(hit: Grids) -> float:
        there = World(hit, world.seen, world.place, world.near)
        make = ROLLOUT.expected if channels == 1 else ROLLOUT.rendered
        made = make(Scene(mass, there, CENTRE, futures, movers))
        return float((made.reshape(by.shape).astype(np.float64) * by).sum())

    found = ROLLOUT.gradient(by, Scene(mass, world, CENTRE, futures, movers))
    assert found.shape == world.hit.shape
    step = 2e-4  # small: where another ray becomes a cell's most transparent one, there is a kink
    for _ in range(6):
        direction = random.normal(size=found.shape).astype(np.float32)
        slope = (value(world.hit + step * direction) - value(world.hit - step * direction)) / (2 * step)
        assert (found * direction).sum() == pytest.approx(slope, rel=0.002, abs=0.003 * float(np.linalg.norm(found)))
    for place in np.argwhere(np.abs(found) > np.abs(found).max() / 4)[:12]:
        direction = np.zeros_like(found)
        direction[tuple(place)] = 1
        slope = (value(world.hit + 0.02 * direction) - value(world.hit - 0.02 * direction)) / 0.04
        assert found[tuple(place)] == pytest.approx(slope, rel=0.05)


def test_a_wall_is_pulled_away_where_free_cells_behind_it_are_wanted() -> None:
    """One cell on the only ray: d m(F) behind it = -0.95 d opaque, with opaque = q^2 / (q + c (1 - q))."""
    hit = np.zeros((1, CELLS, CELLS), np.float32)
    hit[0, 8 + 4, 8] = q = 0.5
    by = np.zeros((1, 4, CELLS, CELLS), np.float32)
    by[0, 1, 8 + 6, 8] = 1
    rollout = Rollout((0.0, 0.0), grid=GridSpec(CELLS), body=(-0.1, 0.1, 0.1), clump=0.5)
    found = rollout.gradient(
        by, Scene(np.zeros((2, CELLS, CELLS), np.float32), World(hit), np.zeros(2, int), np.zeros((1, 1, 3)))
    )
    some = q + 0.5 * (1 - q)
    assert found[0, 8 + 4, 8] == pytest.approx(-0.95 * (2 * q * some - q * q * 0.5) / some**2, rel=1e-4)
    assert found[0, 8 + 6, 8] == pytest.approx(-0.95 * (1 - q * q / some), rel=1e-4), "not free where it is hit"
    assert found[0, 8 - 4, 8] == 0, "on another ray"


def test_a_world_alike_for_all_horizons_has_the_sum_of_their_gradients_and_a_rim_none() -> None:
    mass, world, futures, _ = scene(3, False, False)
    alike = World(np.repeat(world.hit[:1], 3, axis=0))
    by = np.random.default_rng(1).normal(size=(3, 1, CELLS, CELLS)).astype(np.float32)
    each = ROLLOUT.gradient(by, Scene(mass, alike, CENTRE, futures))
    once = ROLLOUT.gradient(by, Scene(mass, World(world.hit[:1]), CENTRE, futures))
    np.testing.assert_allclose(once[0], each.sum(axis=0), atol=1e-5)
    inner = slice(7, -7)
    beyond = Rollout((0.2, -0.1), grid=GridSpec(CELLS), body=(-0.1, 0.1, 0.1), beyond=0.0)
    part = World(world.hit[:1, inner, inner])
    assert beyond.gradient(by, Scene(mass, part, CENTRE, futures)).shape == part.hit.shape
