"""Dynamic grids of a drive: the moving decision by hand, the store's arrays, streaming against the whole drive."""

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
import torch

from envpred.mapping import evidence
from envpred.mapping.dogma import (
    DogmaParameters,
    confident,
    is_moving,
    mahalanobis,
    moving_velocity,
    run,
    scaled,
    to_byte,
)
from envpred.mapping.geometry import EGO, OCCUPIED, GridSpec
from envpred.mapping.particle_forecast import forecast
from envpred.mapping.particle_state import GROUND, ParticleFilterParameters, initial_state
from envpred.mapping.particles import DogmaGrid, step
from tests.mapping.filters import block_scene

SMALL = DogmaParameters(ParticleFilterParameters(persistent=2000, births=200))
TINY = GridSpec(cells=16)


def drive(frames: int = 6, cells: int = 16) -> tuple[np.ndarray, np.ndarray]:
    """Random measurements (T, 2, H, W) and centre cells (T, 2) of a drive that wanders."""
    random = np.random.default_rng(0)
    labels = random.integers(0, 4, (frames, cells, cells), dtype=np.uint8)
    return evidence.measured(labels), random.integers(-2, 3, (frames, 2)).cumsum(0)


def test_mahalanobis_by_hand() -> None:
    velocity = torch.tensor([3.0, 1.0]).view(2, 1, 1)
    covariance = torch.tensor([2.0, 0.5, 1.0]).view(3, 1, 1)
    v, p = np.array([3.0, 1.0]), np.array([[2.0, 0.5], [0.5, 1.0]])
    assert mahalanobis(velocity, covariance).item() == pytest.approx(v @ np.linalg.inv(p) @ v, rel=1e-6)


def test_threshold_and_degenerate_covariances() -> None:
    # Unit covariance: the distance is the squared speed, so 2 m/s is not above tau = 4 and 2.01 m/s is.
    velocity = torch.tensor([[2.0, 2.01, 5.0, 5.0, 5.0], [0.0] * 5]).view(2, 1, 5)
    covariance = torch.tensor([[1, 1, 0, 1e-7, 1.0], [0, 0, 0, 0, 1.0], [1, 1, 0, 1, 1.0]]).view(3, 1, 5)
    assert is_moving(velocity, covariance).tolist() == [[False, True, False, False, False]]
    assert is_moving(velocity, covariance, tau=3.9).tolist() == [[True, True, False, False, False]]
    torch.testing.assert_close(moving_velocity(velocity, covariance)[0], torch.tensor([[0, 2.01, 0, 0, 0]]))


def test_velocity_needs_occupied_mass() -> None:
    mass = torch.tensor([[[0.95, 0.951]], [[0.0, 0.0]]])
    dogma = confident(DogmaGrid(mass, torch.ones(2, 1, 2), torch.ones(3, 1, 2)), SMALL)
    assert dogma.velocity.tolist() == [[[0, 1]], [[0, 1]]]
    assert dogma.covariance[:, 0, 0].tolist() == [0, 0, 0]


def test_scale_is_fixed_and_clipped() -> None:
    np.testing.assert_allclose(scaled(torch.tensor([-50.0, -10.0, 0.0, 5.0, 50.0])), [-1, -0.5, 0, 0.25, 1])
    np.testing.assert_allclose(scaled(torch.tensor([5.0]), scale=10.0), [0.5])


def test_bytes_are_rounded() -> None:
    assert to_byte(torch.tensor([0.0, 0.5, 0.998, 1.0])).tolist() == [0, 128, 254, 255]


@pytest.mark.parametrize("frame", ["ego", "ground"])
def test_streaming_equals_the_whole_drive(frame: Literal["ego", "ground"]) -> None:
    measured, centre_cell = drive()
    parameters = replace(SMALL, filter=replace(SMALL.filter, frame=frame))
    whole = run(measured, centre_cell, parameters, TINY, seed=3, with_forecast=True)
    assert whole.forecast is not None
    generator, state = torch.Generator().manual_seed(3), initial_state(parameters.filter, TINY)
    for t, now in enumerate(measured):
        shift = (centre_cell[t] - centre_cell[max(t - 1, 0)]).tolist()
        state, dogma = step(state, torch.from_numpy(now.copy()), shift, parameters.filter, TINY, generator)
        dogma = confident(dogma, parameters)
        np.testing.assert_array_equal(whole.velocity[t], dogma.velocity.half())
        np.testing.assert_array_equal(whole.covariance[t], dogma.covariance.half())
        moving = is_moving(dogma.velocity, dogma.covariance)
        back = min(t, 5)  # of what is relative to the ground, the grid drives away: as fast as over half a second
        drift = (centre_cell[t] - centre_cell[t - back]) / max(back, 1) * TINY.resolution / 0.1
        drift = drift.tolist() if frame == "ground" else (0, 0)
        ahead = forecast(state, moving, parameters.filter, TINY, generator, drift=drift)
        np.testing.assert_array_equal(whole.forecast[t], to_byte(ahead))


def test_a_forecast_lies_in_the_grid_of_its_frame_whatever_velocities_are_relative_to() -> None:
    """A block moves east at 10 m/s, the ego at 20/3: it gains one cell a frame, whoever looks at it."""
    grid, numbers = GridSpec(cells=48), replace(GROUND, persistent=20_000, births=2_000)
    grids, _ = block_scene(grid, 24, (10.0, 0.0), ego_cells=(2, 0))
    measured = torch.stack(grids).numpy()
    centre_cell = np.stack([2 * np.arange(24), np.zeros(24, int)], 1)
    whole = run(measured[:-5], centre_cell[:-5], DogmaParameters(numbers), grid, with_forecast=True)
    assert whole.forecast is not None

    def east(field: np.ndarray) -> float:
        return float((field.sum(1) * np.arange(48)).sum() / field.sum())

    actual = east((measured[-1, 0] > 0).astype(float))
    # On the grid of the frame that it was made in it would lie 10 cells further.
    assert east(whole.forecast[-1, 4].astype(float)) == pytest.approx(actual, abs=1.5)


def test_a_drive_of_20_hz_is_forecast_as_far_in_time() -> None:
    measured, centre_cell = drive()
    dogma = run(measured, centre_cell, SMALL, TINY, with_forecast=True, period=0.05)
    assert dogma.forecast is not None
    assert dogma.forecast.shape == (6, 30, 16, 16)


def test_arrays_of_the_store() -> None:
    measured, centre_cell = drive()
    dogma = run(measured, centre_cell, SMALL, TINY, with_forecast=True)
    assert dogma.forecast is not None
    assert [array.dtype.name for array in (dogma.velocity, dogma.covariance, dogma.forecast)] == ["float16"] * 2 + [
        "uint8"
    ]
    assert dogma.velocity.shape == (6, 2, 16, 16)
    assert dogma.covariance.shape == (6, 3, 16, 16)
    assert dogma.forecast.shape == (6, 15, 16, 16)
    assert run(measured, centre_cell, SMALL, TINY).forecast is None


def test_same_seed_same_arrays() -> None:
    measured, centre_cell = drive()
    a, b, c = (run(measured, centre_cell, SMALL, TINY, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(a.velocity, b.velocity)
    assert (a.velocity != c.velocity).any()


def test_shapes_that_do_not_belong_together() -> None:
    measured, centre_cell = drive()
    with pytest.raises(ValueError, match=r"measured \(T,2,H,W\) and centre_cell \(T,2\) expected"):
        run(measured, centre_cell[1:], SMALL, TINY)
    with pytest.raises(ValueError, match=r"measured masses \(2,128,128\)"):
        run(measured, centre_cell, SMALL)


def test_ego_velocity_of_a_real_drive(shared: Path) -> None:
    """The ego itself is a known mover: its cells stand still relative to it and move with it relative to the ground."""
    with np.load(shared / "reference" / "label_grids_0013.npz") as file:
        labels, centre_cell = file["labels"][:25], file["centre_cell"][:25]
    actual = (centre_cell[24] - centre_cell[14]) * GridSpec().resolution  # metres in ten frames are m/s
    assert np.hypot(*actual) > 8
    for parameters, expected in ((ParticleFilterParameters(), 0 * actual), (GROUND, actual)):
        few = DogmaParameters(replace(parameters, persistent=100_000, births=10_000))
        velocity = run(evidence.measured(labels), centre_cell, few).velocity[-5:].astype(np.float32)
        cells = np.moveaxis(velocity, 1, -1)
        assert np.hypot(*(np.median(cells[labels[-5:] == EGO], axis=0) - expected)) < 1.0
    assert np.hypot(*np.median(cells[labels[-5:] == OCCUPIED], axis=0)) < 1.5  # walls, and some cars that keep up
