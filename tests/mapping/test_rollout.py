"""Measuring the future again: a static world cell by cell against the mapping, and worlds worked out by hand."""

import numpy as np
import pytest
from numpy.typing import NDArray

from envpred.mapping.evidence import accumulate, pignistic
from envpred.mapping.geometry import FloatArray, GridSpec
from envpred.mapping.label_grid import RayCasting
from envpred.mapping.rollout import Rollout
from envpred.mapping.world import label_world

SPEC = GridSpec(64)
CONTEXT = 128
SENSOR = (0.81, -0.32)
ORIGIN = np.array([-50.0, 30.0])
Grid = NDArray[np.float32]


def drive(frames: int, turn: float, speed: float = 9.0) -> FloatArray:
    """Body poses (T, 3) in cells and radians: a circle that does not hit cells' centres."""
    heading = 0.3 + turn * np.arange(frames)
    chords = np.exp(1j * (heading + turn / 2)) * speed * 0.1 / SPEC.resolution
    places = 200.3 - 90.7j + np.concatenate([[0], np.cumsum(chords[:-1])])
    return np.stack([places.real, places.imag, heading], axis=1)


def measured(obstacles: FloatArray, poses: FloatArray, spec: GridSpec) -> tuple[NDArray[np.uint8], NDArray[np.int32]]:
    """What the mapping measures of obstacle points (M, 2), in metres of the world, along `poses`."""
    centres = np.floor(poses[:, :2] + 0.5).astype(np.int32)
    labels = np.empty((len(poses), spec.cells, spec.cells), np.uint8)
    for t, (x, y, heading) in enumerate(poses):
        pose = np.eye(4)
        pose[:2, :2] = [[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]]
        pose[:2, 3] = ORIGIN + np.array([x, y]) * spec.resolution + pose[:2, :2] @ SENSOR
        points = np.zeros((len(obstacles), 4), np.float32)
        points[:, :2] = (obstacles - pose[:2, 3]) @ pose[:2, :2]
        labels[t] = RayCasting().label(points, np.ones(len(points), np.bool_), pose, centres[t], ORIGIN, spec)
    return labels, centres


@pytest.mark.parametrize(("turn", "seed"), [(0.0, 0), (0.04, 1), (-0.1, 2)])
def test_a_static_world_is_measured_as_the_mapping_measures_it(turn: float, seed: int) -> None:
    """Obstacles at the centres of cells, off the ego's way: labels, masses and forecasts of 12 frames, cell by cell."""
    random = np.random.default_rng(seed)
    poses = drive(17, turn)
    cells = poses[4, :2].round() + random.integers(-60, 60, (400, 2))
    near = np.abs(cells[:, None] - poses[None, :, :2]).max(axis=2).min(axis=1) < 11
    obstacles = ORIGIN + cells[~near] * SPEC.resolution
    labels, centres = measured(obstacles, poses, SPEC)
    mass = accumulate(labels, centres)
    wide, _ = measured(obstacles, poses[4:5], GridSpec(CONTEXT))
    world = label_world(wide[0], 1.0)
    found = Rollout(SENSOR, grid=SPEC).expected(mass[4], world, centres[4], poses[None, 5:])
    assert np.abs(found - pignistic(mass[5:])).max() < 2e-6
    drawn = Rollout(SENSOR, grid=SPEC).samples(mass[4], world, centres[4], poses[None, 5:], random)
    assert (drawn[0] == found).all(), "nothing is left to chance in a world of 0 and 1"
    still = pignistic(mass[4])
    assert np.abs(still - pignistic(mass[-1])).max() > 0.9, "a drive on which things change"
