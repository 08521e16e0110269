"""Scenes in files and together."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from envpred.errors import UserError
from envpred.results.scenes import read_scenes, together, write_scenes
from tests.results.scenes import scene


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
    with pytest.raises(UserError, match=r"again forecasts cells of 0\.5 m every 0\.1 s, not of 0\.333 m every 0\.1 s"):
        together([first, replace(again[3], resolution=0.5)])
    (tmp_path / "drawn.npz").write_bytes(b"PK")
    with pytest.raises(UserError, match="damaged"):
        read_scenes(tmp_path / "drawn.npz", "again")
    assert [file.name for file in tmp_path.iterdir()] == ["drawn.npz"]


def test_a_scene_keeps_the_size_of_cells_the_period_and_the_context(tmp_path: Path) -> None:
    wide = np.random.default_rng(0).random((128, 128)).astype(np.float32)
    first = scene(resolution=0.2, period=0.05, context=wide)
    write_scenes(tmp_path / "drawn.npz", {0: first})
    again = read_scenes(tmp_path / "drawn.npz", "again", oracle=True)[0]
    assert (again.resolution, again.period, again.oracles) == (0.2, 0.05, frozenset({"again"}))
    assert again.context is not None
    np.testing.assert_allclose(again.context, wide, atol=5e-4)
    write_scenes(tmp_path / "drawn.npz", {0: scene()})
    plain = read_scenes(tmp_path / "drawn.npz", "plain")[0]
    assert plain.context is None
    assert not plain.oracles


def test_what_scenes_know_is_put_together() -> None:
    plain, bound = scene(), scene(context=np.zeros((128, 128), np.float32)).named("bound")
    bound = replace(bound, oracles=frozenset({"bound"}))
    both = together([plain, bound])
    assert both.oracles == {"bound"}
    assert both.context is not None
    assert bound.named("renamed").oracles == {"renamed"}
    assert not plain.named("renamed").oracles


@pytest.mark.parametrize(
    ("forecasts", "period", "shown"),
    [
        (8, 0.1, (1, 5)),
        (15, 0.1, (1, 5, 10, 15)),
        (20, 0.1, (1, 5, 10, 15, 20)),
        (30, 0.05, (2, 10, 20, 30)),
        (8, 0.2, (5, 8)),
        (3, 0.04, (3,)),
    ],
)
def test_horizons_that_pictures_show(forecasts: int, period: float, shown: tuple[int, ...]) -> None:
    assert scene(forecasts=forecasts, period=period).shown == shown
