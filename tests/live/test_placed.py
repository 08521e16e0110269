"""Where forecasts lie, and what is left of the ego that they were made for."""

import numpy as np
import pytest

from envpred.live.placed import TRAIL
from tests.live.forecasts import HOME, cell, empty, standing


def test_the_forecasts_own_ego_is_no_obstacle() -> None:
    """It drives east by 2 m a second; its cells are taken from before it came, and so is the trail that it leaves.

    Cells of a metre are the ego's within 2 m of a body of 2 m by 1 m, by the mapping's margin and by one for its egos.
    """
    ego = HOME + np.array([[2.0, 0, 0], [4, 0, 0], [6, 0, 0]])
    grids = np.full((3, 16, 16), 0.8, np.float32)
    present = np.full((48, 48), 0.3, np.float32)
    told = standing(grids, ego=ego, present=present, period=TRAIL / 2).told()
    assert told[0, 8, 8] == pytest.approx(0.0)  # x = 22 was under the ego at the present
    assert told[0, 8 + 2, 8] == pytest.approx(0.3)  # x = 24: not yet
    assert told[0, 8 + 4, 8] == pytest.approx(0.8)  # x = 26, out of the way
    assert told[0, 8, 8 + 5] == pytest.approx(0.8)
    assert told[2, 8 + 2, 8] == pytest.approx(0.8)  # x = 28: what was told of it before
    assert told[2, 8 - 7, 8] == pytest.approx(0.0)  # x = 19: left half a second ago
    longer = standing(grids, ego=ego, present=present, period=TRAIL).told()
    assert longer[2, 8 - 7, 8] == pytest.approx(0.8)  # and more than that


def test_what_lies_beyond_what_is_known_is_not_told() -> None:
    forecast = standing(empty(2), ego=np.tile(HOME + np.array([20, 0, 0]), (2, 1)))
    told = forecast.told()
    assert np.isfinite(told[:, :11]).all()  # the present ends 23 m east of its ego
    assert np.isnan(told[:, 12:]).all()
    known = np.ones((48, 48), np.bool_)
    known[30, 29] = False  # x = 26, y = 20
    (told,) = standing(empty(1), known=known).told()
    assert np.isnan(told[cell(26)])
    assert np.count_nonzero(np.isnan(told)) == 1


def test_grids_and_egos_must_belong_together() -> None:
    with pytest.raises(ValueError, match="do not belong together"):
        standing(empty(3), ego=np.tile(HOME, (2, 1)))
    with pytest.raises(ValueError, match="do not belong together"):
        standing(empty(3), samples=empty(3)[None])
