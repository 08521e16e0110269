"""The lattice: where cells lie, by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from envpred.errors import UserError
from envpred.mapping.geometry import GridSpec, heading_of, transform


@pytest.mark.parametrize("cells", [0, 1, 127, -2])
def test_a_grid_without_a_centre_cell_is_refused(cells: int) -> None:
    with pytest.raises(UserError, match="even number"):
        GridSpec(cells)


@pytest.mark.parametrize("resolution", [0.0, -1.0, float("nan")])
def test_a_cell_without_a_side_is_refused(resolution: float) -> None:
    with pytest.raises(UserError, match="above 0"):
        GridSpec(128, resolution)


def test_the_paper_s_grid() -> None:
    spec = GridSpec()
    assert (spec.cells, spec.half) == (128, 64)
    assert spec.side == pytest.approx(42.6667, abs=1e-4)
    assert GridSpec(6).half == 3, "any even number of cells will do"


def test_the_lattice_starts_one_side_southwest_of_the_extremes() -> None:
    spec = GridSpec(4, 0.5)
    positions = np.array([[3.0, 8.0, 1.0], [5.0, -1.0, 2.0], [4.0, 2.0, 3.0]])
    assert spec.lattice_origin(positions).tolist() == [1.0, -3.0]  # (3, -1) less 4 x 0.5


def test_cells_are_centred_on_whole_numbers_of_the_lattice() -> None:
    spec, origin = GridSpec(4, 0.5), np.array([1.0, -3.0])
    # Cell 0 reaches from -0.25 to 0.25 m around the origin, its lower side included.
    east = 1.0 + np.array([-0.26, -0.25, 0.0, 0.24, 0.25, 0.74, 0.75])
    cells = spec.cell_of(np.stack([east, np.full(7, -2.0)], axis=1), origin)
    assert cells.dtype == np.int32
    assert cells.tolist() == [[-1, 2], [0, 2], [0, 2], [0, 2], [1, 2], [1, 2], [2, 2]]
    assert spec.in_cells(np.array([1.6, -3.1, 99.0]), origin) == pytest.approx([1.2, -0.2])


@settings(max_examples=50, deadline=None)
@given(st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)), st.floats(0.1, 2))
def test_a_position_is_within_half_a_cell_of_its_cell_s_centre(position: tuple[float, float], side: float) -> None:
    spec, origin = GridSpec(8, side), np.array([-7.0, 11.0])
    cell = spec.cell_of(np.array(position), origin)
    assert (np.abs(origin + side * cell - position) <= side / 2 + 1e-9).all()


def test_transform_and_heading_of_a_quarter_turn() -> None:
    pose = np.array([[0, -1, 0, 10], [1, 0, 0, 20], [0, 0, 1, 30], [0, 0, 0, 1]], float)
    points = np.array([[1, 0, 0, 0.7], [0, 2, 5, 0.7]], np.float32)
    assert transform(points, pose).tolist() == [[10, 21, 30], [8, 20, 35]]
    assert heading_of(np.stack([np.eye(4), pose, pose @ pose])) == pytest.approx([0, np.pi / 2, np.pi])
