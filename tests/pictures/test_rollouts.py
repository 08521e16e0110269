"""What a rollout's forecast is made of, drawn."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.image import AxesImage
from matplotlib.patches import Rectangle

from envpred.pictures.rollouts import rollout_strip
from tests.results.scenes import CELLS, scene

WIDE = 2 * CELLS


def world() -> np.ndarray:
    """Free but for one cell; looked at in the middle alone."""
    found = np.full((8, WIDE, WIDE), np.nan, np.float32)
    found[:, 32:-32, 30:-32] = 0
    found[:, 70, 40] = 1
    return found


def drawn(image: AxesImage) -> np.ndarray:
    """What is drawn, rows to the north; 0 where nothing is."""
    return np.ma.filled(np.ma.asarray(image.get_array()), 0)


def test_rows_and_their_scales() -> None:
    found = scene()
    rendered = found.target[:8] * np.float32(0.5)
    fig = rollout_strip(found, world(), rendered, rendered + np.float32(0.1), "a window")
    assert [ax.get_title() for ax in fig.axes if ax.get_title()] == ["0.1 s", "0.5 s"]
    assert [ax.get_ylabel() for ax in fig.axes if ax.get_ylabel()] == [
        *(f"{name}\nnorth (m)" for name in ("world", "rendered", "corrected - rendered", "forecast - target")),
        *("probability of a hit", "probability of\noccupied", "correction", "error"),
    ]
    images = [ax.images[0] for ax in fig.axes[:8]]
    assert [image.get_clim() for image in images[::2]] == [(0, 1), (0, 1), (-0.3, 0.3), (-1, 1)]
    np.testing.assert_allclose(drawn(images[5]), 0.1, atol=1e-6)
    np.testing.assert_allclose(drawn(images[7]), (rendered + 0.1 - found.target[:8])[4].T, atol=1e-6)
    errors = [ax.get_xlabel().split("\n")[0] for ax in fig.axes if ax.get_xlabel().startswith("MSE")]
    guesses = [rendered[h] for h in (0, 4)] + [rendered[h] + 0.1 for h in (0, 4)]
    truths = [found.target[h] for h in (0, 4)] * 2
    assert errors == [f"MSE {np.mean((g - t) ** 2):.4f}" for g, t in zip(guesses, truths, strict=True)]


def test_the_world_lies_where_it_is_and_the_judged_grid_moves_over_it() -> None:
    """The ego drives 2 cells a frame east; cell (70, 40) of 128 lies 6 cells east and 24 south of the centre."""
    found = scene()
    fig = rollout_strip(found, world(), found.target[:8])
    near, far = fig.axes[:2]
    assert near.get_xlim() == far.get_xlim()
    assert near.get_ylim()[0] == pytest.approx((30 - 64 - 0.5) / 3)
    assert np.diff(near.get_xlim())[0] == pytest.approx(66 / 3)  # a square of the longer side
    corners = [next(p for p in ax.patches if isinstance(p, Rectangle)).get_x() for ax in (near, far)]
    assert corners == pytest.approx([(2 - CELLS / 2 - 0.5) / 3, (10 - CELLS / 2 - 0.5) / 3])
    left, right, bottom, top = near.images[0].get_extent()
    j, i = np.argwhere(drawn(near.images[0]) == 1)[0]
    cell = (right - left) / WIDE
    assert (left + (i + 0.5) * cell, bottom + (j + 0.5) * cell) == pytest.approx((2, -8))
    assert (top - bottom) == pytest.approx(right - left)


def test_without_a_network_there_is_no_correction() -> None:
    found = scene()
    found = replace(found, oracles=frozenset(found.forecasts))
    fig = rollout_strip(found, world(), found.target[:8])
    assert "correction" not in [ax.get_ylabel() for ax in fig.axes]
    assert [text.get_text() for ax in fig.axes for text in ax.texts] == ["reads the future"]
    assert fig.axes[4].get_xlabel().startswith("MSE 0.0000")
