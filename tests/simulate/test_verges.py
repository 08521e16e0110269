"""A road without a pavement has plants and fences beside it, none on it; wide parking strips hold cars across."""

import numpy as np
import pytest

from envpred.simulate import classes
from envpred.simulate import layout as layouts
from envpred.simulate.layout import STYLES, Layout
from envpred.simulate.streets import BAY
from envpred.simulate.terrain import Terrain
from envpred.simulate.traffic import LANES, Network
from envpred.simulate.verges import BARRIERS, verge


def furnished(style: str, *lanes: tuple[str, float, float]) -> Layout:
    """A street of 150 m to the east: kinds, widths and y of its lanes."""
    rng = np.random.default_rng(3)
    lines = [(LANES.index(kind), width, np.array([[0.0, y], [150.0, y]])) for kind, width, y in lanes]
    terrain = Terrain(
        Network(style, lines, [], []), np.column_stack([np.linspace(0, 150, 80), np.zeros(80)]), 0.01, rng
    )
    layout = Layout(terrain, STYLES[style], rng)
    layout.furnish(Network(style, lines, [], []))
    return layout


def test_a_verge_has_something_of_everything_beside_the_road() -> None:
    things = list(verge(2000.0, np.random.default_rng(0)))
    assert {it.kind for it in things} == {*BARRIERS, "tree", "bush", "sign", "house"}
    assert min(it.side for it in things) > 0.4
    assert max(it.along + it.length for it in things) < 2020


def test_a_road_without_a_pavement_is_planted_on_its_side_alone() -> None:
    layout = furnished("rural", ("driving", 3.3, 0.0))
    beside = np.array([thing.vertices[:, :2].mean(axis=0) for thing in layout.things])
    near = (beside[:, 0] > 0) & (beside[:, 0] < 150) & (beside[:, 1] > -10) & (beside[:, 1] < -1.65)
    assert near.sum() > 8
    low = np.concatenate([thing.vertices for thing in layout.things if classes.FENCE in thing.label])
    assert (np.abs(low[(low[:, 0] > 0) & (low[:, 0] < 150), 1]) > 1.9).all()


def test_no_verge_where_a_pavement_lies(monkeypatch: pytest.MonkeyPatch) -> None:
    lengths: list[float] = []

    def note(length: float, _: object) -> list[object]:
        lengths.append(length)
        return []

    monkeypatch.setattr(layouts, "verge", note)
    furnished("rural", ("driving", 3.3, 0.0), ("sidewalk", 1.9, -2.6))
    assert not lengths
    furnished("rural", ("driving", 3.3, 0.0), ("sidewalk", 1.9, 2.6))
    assert lengths == [150]


@pytest.mark.parametrize(("width", "across"), [(BAY, True), (2.0, False)])
def test_cars_park_across_wide_strips_and_along_narrow_ones(width: float, across: bool) -> None:
    layout = furnished("car_park", ("driving", 3.0, 0.0), ("parking", width, -1.5 - width / 2))
    strip = [car for car in layout.parked if -1.5 - width < car.place[1] < -1.5]
    assert len(strip) > (25 if across else 10)
    for car in strip:
        assert abs(np.sin(car.heading)) == pytest.approx(float(across), abs=0.15)
    places = np.sort([car.place[0] for car in strip])
    assert np.diff(places).min() > 2.4
