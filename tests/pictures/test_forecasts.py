"""Strips of forecasts."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgba
from matplotlib.patches import Circle, Rectangle
from PIL import Image

from envpred.horizons import in_seconds
from envpred.pictures.forecasts import forecast_strip, scene_parts, scene_strip
from envpred.pictures.grids import DOUBLE, PURPLE, save
from envpred.results.scenes import together
from tests.pictures.legible import illegible
from tests.results.scenes import CELLS, scene


def test_strip(tmp_path: Path) -> None:
    found = replace(scene(2), forecasts={})
    static = np.repeat(found.seen[-1:], len(found.target), axis=0)
    found = replace(found, forecasts={"static": static, "half": found.target * np.float32(0.5)})
    file = tmp_path / "camera.png"
    Image.fromarray(np.zeros((20, 60, 3), np.uint8)).save(file)
    fig = scene_strip(found, (1, 5, 10, 15), camera=lambda frame: None if frame == 32 else file)
    grids = [ax for ax in fig.axes if ax.get_ylabel().endswith("north (m)")]
    assert [ax.get_ylabel().split("\n")[0] for ax in grids] == ["target", "static", "half"]
    assert [ax.get_title() for ax in fig.axes if ax.get_title()] == ["0.0 s, seen", "0.1 s", "0.5 s", "1.0 s"]
    third = [ax for ax in fig.axes if ax.get_xlabel().startswith("MSE")][2]
    error = np.mean((static[9] - found.target[9]) ** 2)
    assert third.get_xlabel().startswith(f"MSE {error:.4f}")
    # the ego and one mover, nothing pushed outside the map
    assert len(third.patches) == 2
    assert third.get_xlim()[1] == pytest.approx((CELLS / 2 - 0.5) / 3)
    assert save(fig, tmp_path / "strip.png").stat().st_size > 10_000


def test_strip_of_forecasts_alone() -> None:
    """Predictions without their store: neither camera, nor what was seen, nor targets."""
    none = np.empty((0, CELLS, CELLS), np.float32)
    fig = scene_strip(replace(scene(), seen=none, target=none), (1, 2))
    assert len([ax for ax in fig.axes if ax.images]) == 2
    assert not [ax for ax in fig.axes if ax.get_title().endswith("seen")]


@pytest.mark.parametrize(("resolution", "period", "east"), [(1 / 3, 0.1, 10.5), (0.2, 0.05, 6.3), (1.0, 0.5, 31.5)])
def test_maps_and_times_are_the_datas_own(resolution: float, period: float, east: float) -> None:
    found = scene(resolution=resolution, period=period)
    for fig in (scene_strip(found, [2]), forecast_strip(found)):
        maps = [ax for ax in fig.axes if ax.images]
        assert all(ax.get_xlim()[1] == pytest.approx(east) for ax in maps)
        for ax in maps[1:]:
            assert all(patch.get_radius() == 3.5 for patch in ax.patches[:1] if isinstance(patch, Circle))
    times = [ax.get_title() for ax in scene_strip(found, [2]).axes if ax.get_title()]
    assert times == ["0.0 s, seen", in_seconds(2 * period)]


def test_movers_are_circled_in_metres() -> None:
    found = scene(resolution=0.5)
    (car,) = found.movers(5)
    marks = [ax for ax in scene_strip(found, [5]).axes if len(ax.patches) == 2]
    assert len(marks) == 2  # in target and forecast
    circle = marks[0].patches[1]
    assert isinstance(circle, Circle)
    assert circle.get_center() == pytest.approx(((car.i - 32) * 0.5, (car.j - 32) * 0.5))


def test_the_context_stands_below_what_was_seen() -> None:
    wide = np.zeros((2 * CELLS, 2 * CELLS), np.float32)
    fig = scene_strip(scene(context=wide), [1, 5])
    (context,) = (ax for ax in fig.axes if ax.get_title().startswith("context"))
    assert context.get_title() == "context, 43 m wide"
    assert context.get_xlim() == pytest.approx(((-CELLS - 0.5) / 3, (CELLS - 0.5) / 3))
    outline = context.patches[1]
    assert isinstance(outline, Rectangle)
    assert (outline.get_x(), outline.get_width()) == pytest.approx(((-CELLS / 2 - 0.5) / 3, CELLS / 3))
    seen = next(ax for ax in fig.axes if ax.get_title() == "0.0 s, seen")
    assert context.get_position().x0 == seen.get_position().x0
    assert context.get_position().y1 < seen.get_position().y0
    assert (len(seen.get_xticks()), len(context.get_xticks()) > 2) == (0, True)  # its title has the place between
    labelled = [ax for ax in fig.axes if ax.get_ylabel().split("\n")[0] in ("target", "static")]
    assert labelled[0].get_position().x0 == pytest.approx(labelled[1].get_position().x0)
    assert labelled[0].get_position().x0 - seen.get_position().x1 > 0.5 / fig.get_figwidth()  # room for the names


def test_an_oracle_is_marked() -> None:
    found = scene()
    found = replace(found, forecasts=found.forecasts | {"bound": found.target}, oracles=frozenset({"bound"}))
    fig = scene_strip(found, [1, 5])
    texts = [text.get_text() for ax in fig.axes for text in ax.texts]
    assert texts == ["reads the future"]
    framed = [ax for ax in fig.axes if ax.images and ax.spines["left"].get_edgecolor() == to_rgba(PURPLE)]
    assert len(framed) == 2
    (row,) = {round(ax.get_position().y0, 6) for ax in framed}
    assert row == round(min(ax.get_position().y0 for ax in fig.axes if ax.images), 6)
    alone = forecast_strip(replace(found, forecasts={"bound": found.target}))
    assert [text.get_text() for ax in alone.axes for text in ax.texts] == ["reads the future"]


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


@pytest.mark.parametrize("methods", [1, 3, 5])
@pytest.mark.parametrize("wide", [True, False])
def test_strips_are_as_wide_as_two_columns_and_legible(methods: int, wide: bool, tmp_path: Path) -> None:
    names = [
        "PredNet, probability DOGMa",
        "Moved last frame and particles",
        "FCN",
        "Last frame, true motion",
        "Rollout",
    ]
    found = scene(context=np.zeros((2 * CELLS, 2 * CELLS), np.float32)) if wide else scene()
    found = replace(found, forecasts=dict.fromkeys(names[:methods], found.target), oracles=frozenset(names[3:4]))
    file = tmp_path / "camera.png"
    Image.fromarray(np.zeros((20, 66, 3), np.uint8)).save(file)
    figures = [scene_strip(found, camera=lambda _: file), scene_strip(found, [1, 5])]
    for fig in figures:
        assert fig.get_figwidth() == DOUBLE
        assert illegible(fig) == []
        assert fig.get_figheight() < 9.5


def test_circles_can_be_left_out() -> None:
    found = scene(context=np.zeros((2 * CELLS, 2 * CELLS), np.float32))
    assert found.movers(5)
    fig = scene_strip(found, [1, 5], circles=False)
    assert not [patch for ax in fig.axes for patch in ax.patches if isinstance(patch, Circle)]
    assert fig.legends == []
    assert [patch for ax in fig.axes for patch in ax.patches if isinstance(patch, Rectangle)]  # the judged grid's edge
    assert scene_strip(found, [1, 5]).legends


def test_many_methods_are_drawn_on_several_pages() -> None:
    found = replace(scene(), forecasts={str(n): scene().target for n in range(7)}, oracles=frozenset("6"))
    first, second = scene_parts(found)
    assert [*first.forecasts, *second.forecasts] == list("0123456")
    assert abs(len(first.forecasts) - len(second.forecasts)) <= 1
    assert scene_parts(first) == [first]


def test_strip_of_errors() -> None:
    found = scene()
    fig = forecast_strip(found, "a window")
    assert [ax.get_title() for ax in fig.axes if ax.get_title()] == ["0.1 s", "0.5 s"]
    assert [ax.get_ylabel() for ax in fig.axes if ax.get_ylabel()] == [
        *(f"{name}\nnorth (m)" for name in ("target", "forecast", "forecast - target")),
        *("probability of\noccupied", "error"),
    ]
