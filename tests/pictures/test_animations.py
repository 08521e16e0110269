"""Animations of forecasts, pixel by pixel."""

import io
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from envpred.pictures.animations import scene_animation
from envpred.results.scenes import Scene
from tests.results.scenes import CELLS, scene


def of_grids(seen: np.ndarray, target: np.ndarray, forecasts: dict[str, np.ndarray], resolution: float = 1.0) -> Scene:
    """A scene of such grids that stands still."""
    place = np.zeros((len(seen) + len(target), 2), np.int64)
    return Scene("a", (0,), seen, target, place, forecasts, resolution, 0.1)


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
    found = of_grids(grey[:3], grey[10:12], {"one": grey[20:23], "two": grey[30:31]})
    gif = scene_animation(found)
    tiles = [[frame[90, x + 32] for x in (6, 76, 146)] for frame in frames_of(gif)]
    shade = [(255 * (1 - np.array(k) / 36)) for k in range(37)]
    expected: list[list[int | None]] = [[0, 0, 0], [1, 1, 1], [2, 2, 2], [10, 20, 30], [11, 21, None], [None, 22, None]]
    for shown, grids in zip(tiles, expected, strict=True):
        for pixel, grid in zip(shown, grids, strict=True):
            assert np.allclose(pixel, 230 if grid is None else shade[grid], atol=1)
    rims = [[tuple(frame[90, x]) for x in (6, 76, 146)] for frame in frames_of(gif)]
    orange, pale = (230, 159, 0), (150, 150, 150)
    assert rims == [[pale] * 3] * 3 + [[pale, orange, orange]] * 3
    bound = frames_of(scene_animation(replace(found, oracles=frozenset({"two"}))))
    assert [tuple(frame[90, 146]) for frame in bound] == [pale] * 3 + [(204, 121, 167)] * 3
    assert [tuple(frame[90, 76]) for frame in bound] == [pale] * 3 + [orange] * 3


def test_animation_is_a_map() -> None:
    """North is up and east right: a cell north-east of the centre lies in the upper right corner."""
    grid = np.zeros((1, 32, 32), np.float32)
    grid[0, 28, 27] = 1
    picture = frames_of(scene_animation(of_grids(np.empty((0, 32, 32)), grid, {"same": grid})))[0][58:122, 6:70]
    dark = np.argwhere(picture[4:-4, 4:-4, 0] < 50) + 4
    assert dark.min(axis=0).tolist() == [8, 56]


def test_animation_of_a_scene_begins_with_what_was_seen() -> None:
    assert len(frames_of(scene_animation(scene()))) == 4 + 8
    assert len(frames_of(scene_animation(replace(scene(), seen=np.empty((0, CELLS, CELLS), np.float32))))) == 8


@pytest.mark.parametrize(("resolution", "pixels"), [(1.0, 20), (1 / 3, 60)])
def test_ten_metres_are_as_long_as_the_cells_say(resolution: float, pixels: int) -> None:
    grid = np.zeros((1, 32, 32), np.float32)
    picture = frames_of(scene_animation(of_grids(grid, grid, {"same": grid}, resolution)))[0]
    light = np.flatnonzero(picture[31, :-6, 0] > 50)
    assert picture.shape[1] - 6 - light[-1] == pytest.approx(pixels, abs=2)


@pytest.mark.parametrize("period", [0.1, 0.05, 0.5])
def test_it_plays_at_half_the_datas_pace(period: float) -> None:
    with Image.open(io.BytesIO(scene_animation(scene(period=period)))) as moving:
        assert moving.info["duration"] == 2000 * period
