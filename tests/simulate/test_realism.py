"""What tells how real drives look, on grids that can be worked out by hand."""

import numpy as np
import pytest

from envpred.mapping.geometry import FREE, OCCUPIED, UNKNOWN
from envpred.simulate.realism import changes


def test_what_becomes_of_cells_is_counted_where_they_lie() -> None:
    """Ten frames of a grid that moves east by a cell a frame; one wall stays, one goes, one comes."""
    labels = np.full((6, 8, 8), FREE, np.uint8)
    labels[0, 6, 1], labels[5, 1, 1] = OCCUPIED, OCCUPIED  # the same place, five cells further west in the grid
    labels[0, 6, 3] = OCCUPIED  # goes
    labels[5, 1, 5] = OCCUPIED  # comes
    labels[:, :, 7] = UNKNOWN
    centre = np.stack([np.arange(6), np.zeros(6)], axis=1).astype(np.int32)
    found = changes(labels, centre)
    assert found["occupied, free 0.5 s later"] == pytest.approx(1 / 2)
    assert found["free, occupied 0.5 s later"] == pytest.approx(1 / (3 * 7 - 2))
    assert found["label kept for 0.5 s, ego moving"] == pytest.approx((3 * 7 - 2) / (3 * 7))
    assert np.isnan(found["cells that enter within 1.5 s"])


def test_cells_enter_as_the_ego_moves() -> None:
    centre = np.stack([np.arange(31) // 5, np.zeros(31)], axis=1).astype(np.int32)  # 3 cells in 15 frames
    found = changes(np.zeros((31, 8, 8), np.uint8), centre)
    assert found["cells that enter within 1.5 s"] == pytest.approx(3 / 8)
