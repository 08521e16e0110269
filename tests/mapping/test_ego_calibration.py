"""A spread that is known is found again, and covers what it should."""

from dataclasses import replace

import numpy as np
import pytest

from envpred.errors import UserError
from envpred.mapping.ego_calibration import Track, coverage, estimate
from envpred.mapping.ego_motion import EgoMotion

CELL = 1 / 3


def wandering(seed: int, deviation: float, frames: int = 150) -> Track:
    """An ego at 8 m/s east whose position jitters along the way."""
    random = np.random.default_rng(seed)
    way = 8.0 * 0.1 * np.arange(frames) + random.normal(0, deviation, frames)
    poses = np.zeros((frames, 3))
    poses[:, 0] = way / CELL
    return Track(poses, 0.1 * np.arange(frames, dtype=np.float64))


def test_the_spread_of_jitter_is_found_and_covers() -> None:
    tracks = [wandering(seed, 0.02) for seed in range(3)]
    found = estimate(tracks, CELL, motion=EgoMotion(clock=0.0))
    assert found.kept == 0, "accelerations seen are noise"
    assert found.lateral == pytest.approx(0, abs=1e-9)
    # One frame ahead: of the pose itself, of the last shown, of the mean speed: 0.02 sqrt(2 + 2/16 + 2/4) or so.
    assert np.hypot(found.position, found.speed * 0.1) == pytest.approx(0.02 * np.sqrt(2.6), rel=0.1)
    shares = coverage([wandering(9, 0.02)], found, CELL)
    assert shares.shape == (3, 15, 3)
    assert shares[:, [0, 4, 14], 0] == pytest.approx(np.array([[0.5] * 3, [0.8] * 3, [0.95] * 3]), abs=0.12)
    narrow = coverage([wandering(9, 0.02)], replace(found, position=0.0, speed=0.0), CELL)
    assert narrow[2, 0, 0] < 0.3


def test_every_track_counts_alike() -> None:
    still, wild = wandering(0, 0.001, 400), wandering(1, 0.05, 40)
    both = estimate([still, wild], CELL, motion=EgoMotion(clock=0.0))
    alone = estimate([wild], CELL, motion=EgoMotion(clock=0.0))
    ratio = np.hypot(both.position, both.speed * 0.1) / np.hypot(alone.position, alone.speed * 0.1)
    assert ratio == pytest.approx(np.sqrt(0.5), rel=0.1)


def test_drives_that_say_nothing_are_refused() -> None:
    parked = Track(np.zeros((60, 3)), 0.1 * np.arange(60, dtype=np.float64))
    with pytest.raises(UserError, match="faster than 2"):
        estimate([parked], CELL)
    with pytest.raises(UserError, match="20 frames"):
        coverage([Track(parked.poses[:10], parked.times[:10])], EgoMotion(), CELL)
