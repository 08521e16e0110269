"""What moves in a window, and the strip that points at it."""

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from envpred.errors import UserError
from envpred.pictures.forecasts import animation, comparison_strip, forecast_strip, scene_animation, scene_strip
from envpred.pictures.grids import save
from envpred.results.movers import movers, on_lattice_of
from envpred.results.scenes import Scene, read_scenes, together, write_scenes

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
    assert titled == ["0.1 s", "0.5 s", "1.0 s"]  # 15 lies beyond the window
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


def scene(seen: int = 4, forecasts: int = 8) -> Scene:
    """The window as it was seen, and the last frame that was seen as its forecast."""
    occupancy, centre_cell = window()
    shown = tuple(range(30, 30 + seen))
    static = np.repeat(occupancy[seen - 1 : seen], forecasts, axis=0)
    return Scene("a_drive", shown, occupancy[:seen], occupancy[seen:], centre_cell, {"static": static})


def test_a_scene_points_at_what_moves_in_its_targets() -> None:
    found = scene()
    (car,) = found.movers(5)
    assert (car.i, car.j) == (43, 32)  # frame 8
    assert found.movers(9) == []  # beyond the last target
    fig = scene_strip(found, [1, 5], camera=lambda frame: None)
    titled = [ax for ax in fig.axes if ax.get_title()]
    assert [ax.get_title() for ax in titled] == ["0.0 s, seen", "0.1 s", "0.5 s"]
    assert len(titled[2].patches) == 2


def test_a_strip_says_what_is_missing() -> None:
    """Forecasts that reach further than the targets, and one method further than the other."""
    found = scene(forecasts=20)
    short = replace(found, forecasts={"short": found.forecasts["static"][:15]})
    fig = scene_strip(together([found, short]))
    assert [ax.get_title() for ax in fig.axes if ax.get_title()] == [
        "0.0 s, seen",
        "0.1 s",
        "0.5 s",
        "1.0 s",
        "1.5 s",
        "2.0 s",
    ]
    said = [text.get_text() for ax in fig.axes for text in ax.texts]
    assert said.count("no target") == 3  # 1.0 s, 1.5 s, 2.0 s
    assert said.count("not forecast") == 1
    errors = [ax for ax in fig.axes if ax.get_xlabel().startswith("MSE")]
    assert len(errors) == 4


def test_scenes_are_kept_and_put_together(tmp_path: Path) -> None:
    first = scene()
    write_scenes(tmp_path / "drawn.npz", {3: first, 8: replace(first, drive="another")})
    again = read_scenes(tmp_path / "drawn.npz", "again")
    assert list(again) == [3, 8]
    assert again[8].drive == "another"
    assert again[3].frames == (30, 31, 32, 33)
    np.testing.assert_allclose(again[3].target, first.target, atol=5e-4)
    np.testing.assert_array_equal(again[3].centre_cell, first.centre_cell)
    assert list(together([first, again[3]]).forecasts) == ["static", "again"]
    with pytest.raises(UserError, match=r"again forecasts another window \(another, frame 33\)"):
        together([first, again[8]])
    with pytest.raises(UserError, match="again was judged on other grids"):
        together([first, replace(again[3], target=again[3].target[::-1])])
    (tmp_path / "drawn.npz").write_bytes(b"PK")
    with pytest.raises(UserError, match="missing or damaged"):
        read_scenes(tmp_path / "drawn.npz", "again")
    assert [file.name for file in tmp_path.iterdir()] == ["drawn.npz"]


def frames_of(gif: bytes) -> list[np.ndarray]:
    with Image.open(io.BytesIO(gif)) as moving:
        found = []
        for k in range(moving.n_frames):  # type: ignore[attr-defined]
            moving.seek(k)
            found.append(np.asarray(moving.convert("RGB")))
    return found


def test_animation_plays_what_was_seen_then_target_and_forecast() -> None:
    """Grids of one grey each, so that every tile of every frame tells which grid it shows."""
    grey = np.linspace(0, 1, 37)[:, None, None] * np.ones((1, 32, 32))  # as many as there are shades
    gif = animation(grey[:3], grey[10:12], {"one": grey[20:23], "two": grey[30:31]}, scale=2)
    tiles = [[frame[90, x + 32] for x in (6, 76, 146)] for frame in frames_of(gif)]
    shade = [(255 * (1 - np.array(k) / 36)) for k in range(37)]
    expected: list[list[int | None]] = [[0, 0, 0], [1, 1, 1], [2, 2, 2], [10, 20, 30], [11, 21, None], [None, 22, None]]
    for shown, grids in zip(tiles, expected, strict=True):
        for pixel, grid in zip(shown, grids, strict=True):
            assert np.allclose(pixel, 230 if grid is None else shade[grid], atol=1)
    rims = [[tuple(frame[90, x]) for x in (6, 76, 146)] for frame in frames_of(gif)]
    orange, pale = (230, 159, 0), (150, 150, 150)
    assert rims == [[pale] * 3] * 3 + [[pale, orange, orange]] * 3


def test_animation_is_a_map() -> None:
    """North is up and east right: a cell north-east of the centre lies in the upper right corner."""
    grid = np.zeros((1, 32, 32), np.float32)
    grid[0, 28, 27] = 1
    picture = frames_of(animation(np.empty((0, 32, 32)), grid, {"same": grid}))[0][58:122, 6:70]
    dark = np.argwhere(picture[4:-4, 4:-4, 0] < 50) + 4
    assert dark.min(axis=0).tolist() == [8, 56]


def test_animation_of_a_scene_begins_with_what_was_seen() -> None:
    assert len(frames_of(scene_animation(scene()))) == 4 + 8
    assert len(frames_of(scene_animation(replace(scene(), seen=np.empty((0, CELLS, CELLS), np.float32))))) == 8


def test_strip_of_errors() -> None:
    found = scene()
    fig = forecast_strip(found.target, found.forecasts["static"], (1, 5, 15), "a window")
    assert [ax.get_title() for ax in fig.axes if ax.get_title()] == ["0.1 s", "0.5 s"]
    assert [ax.get_ylabel() for ax in fig.axes if ax.get_ylabel()] == [
        *(f"{name}\nnorth (m)" for name in ("target", "forecast", "forecast - target")),
        *("probability of occupied", "error"),
    ]
