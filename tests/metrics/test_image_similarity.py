"""Image similarity of occupancy maps."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_cdt

from envpred.metrics.image_similarity import CLASSES, Empty, ImageSimilarity, class_of, distances, image_similarity

LACK = 2.0 * (128 + 128)


def all_classes() -> NDArray[np.float32]:
    """A map (1, 128, 128) that is free but for one occupied and one unknown cell."""
    grid = np.full((1, 128, 128), 0.1, np.float32)
    grid[0, 60, 40], grid[0, 3, 3] = 0.9, 0.5
    return grid


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(2, 9), st.integers(2, 9))
def test_distances_are_scipys(seed: int, height: int, width: int) -> None:
    classes = np.random.default_rng(seed).choice(3, (height, width), p=[0.1, 0.3, 0.6]).astype(np.uint8)
    classes[seed % height, seed % width] = 0
    expected = distance_transform_cdt(classes != 0, metric="taxicab")
    np.testing.assert_array_equal(distances(classes, 0), expected)


def test_class_bounds() -> None:
    grid = np.array([[0.85, 0.8499999, 0.2, 0.1999999, 1.0, 0.0]], np.float32)
    assert [CLASSES[k] for k in class_of(grid)[0]] == ["occupied", "unknown", "unknown", "free", "occupied", "free"]


def test_equal_maps_are_similar() -> None:
    np.testing.assert_array_equal(image_similarity(all_classes(), all_classes(), LACK), np.zeros((1, 3)))


@pytest.mark.parametrize("k", [1, 7, 50])
def test_a_cell_moved_by_k_costs_2k(k: int) -> None:
    moved = all_classes()
    moved[0, 60, 40], moved[0, 60, 40 + k] = 0.1, 0.9
    psi = image_similarity(moved, all_classes(), LACK)[0]
    assert psi[0] == 2 * k
    # the free cell that became occupied lies 1 from a free one, among 128^2 - 2 free cells, in either direction
    assert psi[1] == pytest.approx(2 / (128**2 - 2))
    assert psi[2] == 0


def test_by_hand_with_unequal_counts() -> None:
    a = np.full((1, 1, 8), 0.5, np.float32)
    b = a.copy()
    a[0, 0, [0, 4]] = 1.0
    b[0, 0, 1] = 1.0
    # d(a, b) = (1 + 3)/2, d(b, a) = 1
    assert image_similarity(a, b, LACK)[0, 0] == 3.0


@pytest.mark.parametrize(("empty", "both"), [("penalty", LACK), ("zero", 0.0)])
def test_lacking_classes(empty: Empty, both: float) -> None:
    free, unknown = np.zeros((1, 128, 128), np.float32), np.full((1, 128, 128), 0.5, np.float32)
    metric = ImageSimilarity(1, empty)
    metric.update(torch.from_numpy(free)[None], torch.from_numpy(unknown)[None])
    result = metric.compute()
    assert result["image_similarity_occupied"].mean.item() == both
    assert result["image_similarity_free"].mean.item() == LACK
    assert result["image_similarity_unknown"].mean.item() == LACK
    assert result["image_similarity"].mean.item() == 2 * LACK + both


def test_horizons_and_windows_keep_their_places() -> None:
    target = torch.from_numpy(all_classes())[None].repeat(2, 2, 1, 1)
    forecast = target.clone()
    forecast[1, 0, 60, 40], forecast[1, 0, 60, 43] = 0.1, 0.9
    metric = ImageSimilarity(2)
    metric.update(forecast, target, index=torch.tensor([0, 1]))
    occupied = metric.compute()["image_similarity_occupied"]
    assert occupied.per_window.tolist() == [[0.0, 0.0], [6.0, 0.0]]
    assert occupied.mean.tolist() == [3.0, 0.0]


def test_unknown_policy_is_refused() -> None:
    with pytest.raises(ValueError, match="'penalty' or 'zero'"):
        ImageSimilarity(1, "nothing")  # type: ignore[arg-type]
