"""The particle forecast: positions and spread by hand, frames of reference, bounds."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from envpred.mapping.geometry import GridSpec
from envpred.mapping.particle_forecast import HORIZONS, forecast, position_deviation
from envpred.mapping.particle_state import ParticleFilterParameters, ParticleState, initial_state

GRID = GridSpec(cells=32)
QUIET = ParticleFilterParameters(persistent=100, births=10, position_noise=0, velocity_noise=0)


def cloud(velocity: tuple[float, float], weight: float = 0.01, count: int = 100) -> ParticleState:
    """`count` particles at the centre of cell (10, 12) with one velocity."""
    return replace(
        initial_state(QUIET, GRID),
        position=torch.tensor([[10.5], [12.5]]).repeat(1, count),
        velocity=torch.tensor(velocity)[:, None].repeat(1, count),
        weight=torch.tensor(weight),
    )


def everywhere() -> torch.Tensor:
    return torch.ones(32, 32, dtype=torch.bool)


def test_constant_velocity() -> None:
    # 10/3 m/s is one cell of 1/3 m a frame.
    ahead = forecast(cloud((10 / 3, -10 / 6), weight=0.008), everywhere(), QUIET, GRID, torch.Generator())
    assert ahead.shape == (HORIZONS, 32, 32)
    for h in (2, 4, 14):
        assert ahead[h - 1].nonzero().tolist() == [[10 + h, 12 - h // 2]]
        assert ahead[h - 1].sum().item() == pytest.approx(0.8)


def test_sum_of_weights_is_capped() -> None:
    ahead = forecast(cloud((0.0, 0.0), weight=0.02), everywhere(), QUIET, GRID, torch.Generator(), horizons=2)
    assert ahead[:, 10, 12].tolist() == [1, 1]


def test_only_moving_cells_take_part_and_leavers_vanish() -> None:
    state = cloud((10 / 3, 0.0))
    assert forecast(state, ~everywhere(), QUIET, GRID, torch.Generator()).count_nonzero() == 0
    fast = forecast(cloud((100.0, 0.0)), everywhere(), QUIET, GRID, torch.Generator())
    assert fast.count_nonzero() == 0


def test_drift_moves_the_grid_along() -> None:
    ahead = forecast(cloud((0.0, 0.0)), everywhere(), QUIET, GRID, torch.Generator(), drift=(10 / 3, 0.0))
    assert ahead[4].nonzero().tolist() == [[5, 12]]


def test_spread_is_that_of_the_linear_model() -> None:
    """The closed form against the process run step by step, at the paper's noise."""
    parameters = replace(QUIET, position_noise=0.05, velocity_noise=0.8)
    random = np.random.default_rng(0)
    x, v = np.zeros(200_000), np.zeros(200_000)
    for h in range(1, HORIZONS + 1):
        x += 0.1 * v + random.normal(0, 0.05, x.size)
        v += random.normal(0, 0.8, x.size)
        assert position_deviation(h, parameters) == pytest.approx(x.std(), rel=0.01)


def test_noise_reaches_the_grid() -> None:
    parameters = replace(QUIET, velocity_noise=0.8)
    state = cloud((0.0, 0.0), weight=1e-5, count=50_000)
    ahead = forecast(state, everywhere(), parameters, GRID, torch.Generator().manual_seed(0))
    i = torch.arange(32) + 0.5
    for h in (6, 10):
        east = ahead[h - 1].sum(1) / ahead[h - 1].sum()
        deviation = ((east * (i - 10.5) ** 2).sum() - 1 / 12).sqrt() * GRID.resolution  # 1/12: width of a cell
        assert deviation.item() == pytest.approx(position_deviation(h, parameters), rel=0.03)
