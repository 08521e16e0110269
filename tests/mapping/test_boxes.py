"""Cells in boxes of tracked objects, and how fast boxes are."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from envpred.drives.tracklets import VISIBLE, Tracklet
from envpred.mapping.boxes import in_box, speeds
from envpred.mapping.geometry import GridSpec

GRID = GridSpec(8, 1.0)  # cells -4 to 3 around the centre cell, a metre each
CORNER = np.zeros(2)


def cells(
    x: float, y: float, heading: float, length: float, width: float, centre: tuple[int, int] = (0, 0)
) -> set[tuple[int, int]]:
    """The covered cells, by their place around (0, 0)."""
    inside = in_box(np.array([x, y]), heading, (length, width), np.array(centre), CORNER, GRID)
    return {(int(i), int(j)) for i, j in np.argwhere(inside) - GRID.half + np.array(centre)}


def test_boxes_by_hand() -> None:
    """A cell is covered if its middle is within half a cell of the box."""
    assert cells(0, 0, 0, 2, 0.2) == {(-1, 0), (0, 0), (1, 0)}
    assert cells(0, 0, np.pi / 2, 2, 0.2) == {(0, -1), (0, 0), (0, 1)}
    assert cells(0, 0, np.pi / 4, 4, 0.2) == {(-1, -1), (0, 0), (1, 1)}  # along: sqrt(2) a cell, up to 2.5
    assert cells(0.4, -2, 0, 0.1, 1.2) == {(0, -3), (0, -2), (0, -1)}
    assert cells(0, 0, 0, 2, 0.2, centre=(5, -1)) == {(1, 0)}  # that grid begins at cell 1
    assert cells(20, 0, 0, 4, 2) == set()
    assert cells(5, 0, 0, 4, 0.2) == {(3, 0)}


@given(st.floats(-6, 6), st.floats(-6, 6), st.floats(-4, 4), st.floats(0.1, 9), st.floats(0.1, 4), st.integers(-2, 2))
def test_cells_in_a_box_are_points_in_it(
    x: float, y: float, heading: float, length: float, width: float, shift: int
) -> None:
    """The middle of a cell lies in the box made half a cell larger; of another grid it is the same cell."""
    box = Tracklet("Car", (length, width, 2.0), 0, [(x, y, -1.0, heading)], [VISIBLE])
    place = np.stack(np.meshgrid(*[np.arange(-4.0, 4)] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
    points = np.column_stack([place, np.zeros(len(place))])
    tolerance = 1e-9
    sure, perhaps = (box.contains(0, points, GRID.resolution / 2 + off) for off in (-tolerance, tolerance))
    found = in_box(np.array([x, y]), heading, (length, width), np.zeros(2, int), CORNER, GRID)
    assert (sure <= found.ravel()).all()
    assert (found.ravel() <= perhaps).all()
    other = in_box(np.array([x, y]), heading, (length, width), np.array([shift, 0]), CORNER, GRID)
    both = slice(max(0, shift), 8 + min(0, shift)), slice(max(0, -shift), 8 - max(0, shift))
    np.testing.assert_array_equal(found[both[0]], other[both[1]])


def test_speeds_by_hand() -> None:
    """Over half a second either way, as far as there are frames; of 10 Hz that is five of them."""
    time = np.arange(21, dtype=np.float64) / 10
    way = np.where(time < 1, 0.0, 3 * (time - 1))  # 3 m/s from the first second on
    found = speeds(np.stack([way, np.full(21, 7.0)], axis=1), time)
    assert found[:6] == pytest.approx(0)
    assert found[10] == pytest.approx(1.5)  # it stood for half of that time
    assert found[15:] == pytest.approx(3)
    circle = np.stack([4 * np.cos(time / 2), 4 * np.sin(time / 2)], axis=1)  # 2 m/s; the way is that of the chord
    assert speeds(circle, time)[10] == pytest.approx(8 * np.sin(0.25))
    time[15] += 4e-4  # stamps are not exact
    late = speeds(np.stack([np.where(time < 1.5, 0, 2), time * 0], axis=1), time)
    assert late[9:11] == pytest.approx([0, 2 / 1.0004])
    assert speeds(np.ones((1, 2)), np.zeros(1)) == 0
    apart = speeds(np.array([[0.0, 0], [9, 0], [9, 0]]), np.array([0.0, 2, 2.1]))  # after a gap it is seen anew
    assert apart == pytest.approx(0)
