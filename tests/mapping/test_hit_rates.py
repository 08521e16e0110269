"""The calibrated world: features by hand, ranges and horizons, and weights found again from labels drawn by them."""

import numpy as np
import pytest
from numpy.typing import NDArray

from envpred.mapping import hit_rates
from envpred.mapping.evidence import accumulate
from envpred.mapping.geometry import FREE, OCCUPIED
from envpred.mapping.hit_rate_fit import HORIZONS, Examples, examples, fit, log_loss
from envpred.mapping.hit_rates import FEATURES, NUMBERS, HitRates, features

W, CELL = 32, 1 / 3


def shown() -> tuple[NDArray[np.uint8], NDArray[np.int32], NDArray[np.float32]]:
    """Three frames (3, W, W), the grid moving one cell east each, with a post that is hit in the first and the last."""
    labels = np.full((3, W, W), FREE, np.uint8)
    centres = np.array([[10, 5], [11, 5], [12, 5]], np.int32)
    labels[0, 20, 9] = labels[2, 18, 9] = OCCUPIED
    return labels, centres, accumulate(labels, centres)[-1]


def test_features_follow_the_cell_through_the_lattice() -> None:
    found = features(*shown(), (0, 0, W, W))
    assert found.shape == (FEATURES, W, W)
    post = found[:, 18, 9]
    assert post[:11].tolist() == [1, 1, 0, 1, 0, 0, 0, 1, 0, 0, 0], "one; hits from the last frame back; free alike"
    mass = shown()[2]
    assert post[11:13] == pytest.approx(mass[:, 18, 9])
    assert post[15] == 0, "hits around, itself not counted"
    beside = found[:, 19, 9]
    assert beside[1:6].sum() == 0
    assert beside[15:17] == pytest.approx([1 / 8, 1 / 32])
    assert beside[18] == pytest.approx(2 * 6 / 405), "2 hits, seen by 2 x 3 of the 81 pairs of neighbours"
    # What lay beyond the first grid's rim is unknown in that frame: the last two columns.
    assert found[8, -3:, 0].tolist() == [1, 0, 0]
    assert found[7, -3:, 0].tolist() == [1, 1, 0]
    assert (features(*shown(), (15, 7, 22, 12)) == found[:, 15:22, 7:12]).all()


def test_the_world_is_that_of_the_weights() -> None:
    """sigmoid(-1 + 2 hit + 0.5 log(time) hit + 0.3 range then), in the box of the judged grids alone."""
    weights = np.zeros(NUMBERS)
    weights[0], weights[1], weights[FEATURES + 1], weights[4 * FEATURES + 1] = -1, 2, 0.5, 0.3
    labels, centres, mass = shown()
    pose = np.array([12.2, 5.1, 0.0])
    futures = np.array([[[14.0, 5.0, 0], [16.0, 5.0, 0]], [[15.0, 5.0, 0], [18.0, 5.0, 0]]])
    world = HitRates(weights, weights).world(labels, centres, mass, futures, pose, CELL, 8)
    assert world.part is not None
    assert world.cells == W
    assert world.hit.shape == (2, world.part[2] - world.part[0], world.part[3] - world.part[1])
    cell = np.array([18 + 12 - 16, 9 + 5 - 16])
    for h, (x, time) in enumerate(((14.5, 0.0), (17.0, np.log(2)))):
        there = np.hypot(*(cell - [x, 5.0])) * CELL / 20
        score = -1 + 2 + 0.5 * time + 0.3 * there
        # The judged grids of 8 cells do not reach the post: the world ends before it.
        assert not (world.part[0] <= 18 < world.part[2] and world.part[1] <= 9 < world.part[3])
        wide = HitRates(weights, weights).world(labels, centres, mass, futures, pose, CELL, 16)
        assert wide.hit[h, 18 - wide.first[0], 9 - wide.first[1]] == pytest.approx(1 / (1 + np.exp(-score)), abs=1e-6)
    assert world.place == (12.2, 5.1)
    assert world.seen is not None
    far = HitRates(weights, weights).world(labels, centres, mass, futures + np.array([20.0, 0, 0]), pose, CELL, 8)
    assert far.seen is None, "nobody is near where the frames shown were taken"


def test_a_post_that_was_hit_is_hit_again_and_an_empty_street_is_not() -> None:
    """What the weights that ship say of a wall hit five times, a cell hit once, and free space."""
    labels = np.full((5, W, W), FREE, np.uint8)
    labels[:, 24, 10:20] = OCCUPIED
    labels[2, 8, 8] = OCCUPIED
    centres = np.zeros((5, 2), np.int32)
    mass = accumulate(labels, centres)[-1]
    futures = np.zeros((1, 15, 3))
    world = hit_rates.default().world(labels, centres, mass, futures, np.zeros(3), CELL, W)
    assert world.seen is not None
    assert world.hit[0, 24, 15] > 0.9
    assert 0.3 < world.hit[14, 24, 15] < world.hit[0, 24, 15]
    assert world.hit[0, 12, 26] < 0.01
    assert 2 * world.hit[0, 12, 26] < world.hit[0, 8, 8] < 0.5
    assert world.seen[0, 12, 26] > 0.9
    assert world.hit.max() <= 0.995


def test_weights_that_draw_labels_are_found_again() -> None:
    random = np.random.default_rng(0)
    inputs = np.zeros((6000, NUMBERS), np.float32)
    inputs[:, 0] = 1
    inputs[:, 1:4] = random.random((6000, 3))
    chance = 1 / (1 + np.exp(-(inputs[:, 1:4] @ [3.0, -2.0, 0.5] - 1)))
    hit = random.random(6000) < chance
    free = random.random(6000) < 0.8
    label = np.where(hit, OCCUPIED, np.where(free, FREE, 0)).astype(np.uint8)
    drive = Examples(inputs, label, np.full(6000, 1 / 6000, np.float32))
    rates = fit([drive, drive], [1.0, 2.0])
    assert rates.hit[:4] == pytest.approx([-1, 3, -2, 0.5], abs=0.35)
    assert 1 / (1 + np.exp(-rates.seen[0] - rates.seen[1:4].mean() * 1.5)) == pytest.approx(0.8, abs=0.05)
    hits, seen = log_loss(rates, drive)
    assert hits == pytest.approx(-np.mean(np.log(np.where(hit, chance, 1 - chance))), abs=0.01)
    assert seen == pytest.approx(-(0.8 * np.log(0.8) + 0.2 * np.log(0.2)), abs=0.03)


def test_examples_are_of_cells_that_the_judged_grid_covers_later() -> None:
    """A drive of 21 frames east; every cell drawn: 16 x 16 for each horizon, their labels those of the later frame."""
    T = 21
    labels = np.full((T, W, W), FREE, np.uint8)
    centres = np.stack([np.arange(T), np.zeros(T, int)], axis=1)
    labels[:, 16 + 3, 20] = OCCUPIED  # moves with the ego: hit at every frame, each time in another cell
    poses = np.column_stack([np.arange(T), np.zeros(T), np.zeros(T)]).astype(np.float64)
    drawn = examples(
        labels, accumulate(labels, centres), centres, poses, CELL, 16, np.random.default_rng(0), 8, 1.0, 1.0
    )
    # From frame 4 alone; of the eight horizons the last, 15 frames, takes the cell out of the context.
    assert (drawn.label == OCCUPIED).sum() == 7
    assert len(drawn.label) == 16 * sum(min(16, 24 - h) for h in HORIZONS)
    assert drawn.inputs.shape[1] == NUMBERS
    assert drawn.weight.sum() == pytest.approx(1)
    assert set(np.unique(drawn.label)) == {OCCUPIED, FREE}


def test_weights_of_another_length_are_refused() -> None:
    with pytest.raises(ValueError, match=str(NUMBERS)):
        HitRates(np.zeros(3), np.zeros(NUMBERS))
