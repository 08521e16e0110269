"""What moves in a window, and the strip that points at it."""

from pathlib import Path

import numpy as np
import pytest

from envpred.forecast_pictures import comparison_strip
from envpred.movers import movers, on_lattice_of
from envpred.plots import save

CELLS, FRAMES = 64, 12


def window() -> tuple[np.ndarray, np.ndarray]:
    """The ego drives 2 cells a frame east past a wall; a car, 3 x 3 cells, drives 3 cells a frame north."""
    world = np.full((FRAMES, 160, 160), 0.05, np.float32)
    world[:, 20:150, 100:102] = 0.95
    centre_cell = np.array([[50 + 2 * t, 80] for t in range(FRAMES)])
    for t in range(FRAMES):
        world[t, 76:79, 55 + 3 * t : 58 + 3 * t] = 0.95
        world[t, 48 + 2 * t : 52 + 2 * t, 79:82] = 0.95  # the ego itself
    half = CELLS // 2
    grids = [world[t, i - half : i + half, j - half : j + half] for t, (i, j) in enumerate(centre_cell)]
    return np.stack(grids), centre_cell


def test_finds_the_car_and_neither_wall_nor_ego() -> None:
    occupancy, centre_cell = window()
    (car,) = movers(occupancy, centre_cell, frame=8)
    # In the world at (77, 80); the centre cell (66, 80) is (32, 32).
    assert (car.i, car.j) == (43, 32)
    assert 4 <= car.radius < 5
    assert movers(occupancy, centre_cell, frame=8, cells=(10, 99)) == []
    assert movers(occupancy, centre_cell, frame=0) == []


def test_what_came_into_sight_does_not_move() -> None:
    occupancy, centre_cell = window()
    occupancy[:4] = 0.5
    assert movers(occupancy, centre_cell, frame=8) == []


@pytest.mark.parametrize("shift", [(0, 0), (3, -2), (-5, 4), (70, 0)])
def test_moving_a_grid_is_cutting_the_world_elsewhere(shift: tuple[int, int]) -> None:
    world = np.random.default_rng(0).random((220, 220))
    here = world[70:134, 70:134]
    there = world[70 + shift[0] : 134 + shift[0], 70 + shift[1] : 134 + shift[1]]
    moved = on_lattice_of(here, np.array(shift), fill=-1.0)
    seen = moved >= 0
    assert seen.sum() == max(0, 64 - abs(shift[0])) * max(0, 64 - abs(shift[1]))
    np.testing.assert_array_equal(moved[seen], there[seen])


def test_strip(tmp_path: Path) -> None:
    occupancy, centre_cell = window()
    target, horizons = occupancy[2:], (1, 5, 10, 15)
    static = np.repeat(occupancy[1:2], len(target), axis=0)
    circled = [movers(occupancy, centre_cell, 1 + h) for h in horizons if h <= len(target)]
    camera = np.zeros((20, 60, 3), np.uint8)
    fig = comparison_strip(target, {"static": static, "half": target / 2}, horizons, [camera, None, camera], circled)
    grids = [ax for ax in fig.axes if ax.get_ylabel().endswith("north (m)")]
    assert [ax.get_ylabel().split("\n")[0] for ax in grids] == ["target", "static", "half"]
    titled = [ax.get_title() for ax in fig.axes if ax.get_title()]
    assert titled == ["0.1s", "0.5s", "1.0s"]  # 15 lies beyond the window
    third = [ax for ax in fig.axes if ax.get_xlabel().startswith("MSE")][2]
    error = np.mean((static[9] - target[9]) ** 2)
    assert third.get_xlabel().startswith(f"MSE {error:.4f}")
    # the ego and one mover, nothing pushed outside the map
    assert len(third.patches) == 2
    assert third.get_xlim()[1] == pytest.approx((CELLS / 2 - 0.5) / 3)
    assert save(fig, tmp_path / "strip.png").stat().st_size > 10_000


def test_strip_without_camera() -> None:
    occupancy, _ = window()
    fig = comparison_strip(occupancy, {"same": occupancy}, (1, 2))
    assert len([ax for ax in fig.axes if ax.images]) == 4
