"""The particle filter as a whole: invariants, known scenes, bad input."""

from dataclasses import replace
from typing import Any, Literal

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from envpred.errors import UserError
from envpred.mapping.dogma import is_moving
from envpred.mapping.geometry import GridSpec
from envpred.mapping.particle_state import GROUND, initial_state
from envpred.mapping.particles import step
from envpred.mapping.particles.cells import cell_number, sort_by_cell, with_rim, without_rim
from envpred.mapping.particles.resample import resample
from envpred.mapping.shift import shifted_tensor
from tests.mapping.filters import NOBODY, PAPER, SMALL, TINY, block_scene, follow, masses, random_masses, seeded

Frame = Literal["ego", "ground"]
PAPER_MODEL: dict[str, Any] = {
    name: getattr(PAPER, name)
    for name in ("survival", "birth", "birth_velocity", "velocity_noise", "matching", "neighbourhood")
}
DEVICES = ["cpu", pytest.param("cuda", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA"))]


class TestInvariants:
    @given(st.integers(0, 999), st.integers(-9, 9), st.integers(-9, 9), st.sampled_from(["ego", "ground"]))
    @settings(max_examples=25, deadline=None)
    def test_masses_weights_and_count(self, seed: int, east: int, north: int, frame: Frame) -> None:
        parameters = replace(SMALL, frame=frame)
        grids = [random_masses(seed + t, 8) for t in range(4)]
        for state, dogma in follow(grids, (east, north), parameters, seed=seed):
            assert state.position.shape == state.velocity.shape == (2, 300)
            assert torch.equal(state.mass, dogma.mass)
            assert (dogma.mass >= 0).all()
            assert (dogma.mass.sum(0) <= 1 + 1e-6).all()
            assert dogma.velocity.isfinite().all()
            assert (dogma.covariance[[0, 2]] >= 0).all()
            # Resampled particles carry m(O) = rho_p + rho_b of their cell, each part to within one particle, but for
            # what is born in cells that got no newborn (at most one newborn's share).
            count = without_rim(torch.bincount(cell_number(state.position, 8), minlength=100), 8)
            newborn_share = dogma.mass[0].sum() / parameters.births
            assert ((count * state.weight - dogma.mass[0]).abs() <= 2 * state.weight + newborn_share + 1e-5).all()

    def test_persistent_weights_of_a_cell_sum_to_rho_p(self) -> None:
        persisting = torch.rand(8, 8, generator=seeded(1))
        position = 8 * torch.rand(2, 5000, generator=seeded(2))
        particles = sort_by_cell(position, position, 8)
        drawn, _, weight = resample(particles, persisting, NOBODY, torch.zeros(8, 8), seeded(3))
        count = without_rim(torch.bincount(cell_number(drawn, 8), minlength=100), 8)
        assert ((count * weight - persisting).abs() <= weight * (1 + 1e-4)).all()

    def test_free_space_takes_the_particles_mass(self) -> None:
        wall = torch.zeros(8, 8)
        wall[4] = 1
        states = follow([masses(wall)] * 3 + [masses(torch.zeros(8, 8))] * 6)
        assert states[2][0].mass[0].sum() > 7
        assert states[-1][0].mass[0].sum() < 0.01
        assert states[-1][0].weight * 300 < 0.01

    def test_nothing_at_all_gives_nothing(self) -> None:
        state, dogma = follow([torch.zeros(2, 8, 8)] * 3)[-1]
        assert state.mass.count_nonzero() == 0
        assert dogma.mass.count_nonzero() == 0
        assert state.weight == 0
        assert state.position.isfinite().all()

    def test_order_of_particles_does_not_matter(self) -> None:
        quiet = replace(SMALL, position_noise=0, velocity_noise=0)
        state, _ = follow([random_masses(t, 8) for t in range(3)], parameters=quiet)[-1]
        order = torch.randperm(300, generator=seeded(5))
        permuted = replace(state, position=state.position[:, order], velocity=state.velocity[:, order])
        seen = random_masses(3, 8)
        _, dogma = step(state, seen, (1, 0), quiet, TINY, seeded(7))
        _, other = step(permuted, seen, (1, 0), quiet, TINY, seeded(7))
        assert torch.equal(dogma.mass, other.mass)
        torch.testing.assert_close(dogma.velocity, other.velocity, atol=1e-5, rtol=0)
        torch.testing.assert_close(dogma.covariance, other.covariance, atol=1e-5, rtol=0)

    def test_same_seed_same_bits_other_seed_other_particles(self) -> None:
        grids = [random_masses(t, 8) for t in range(3)]
        (a, _), (b, _), (c, _) = (follow(grids, seed=seed)[-1] for seed in (1, 1, 2))
        assert torch.equal(a.position, b.position)
        assert torch.equal(a.velocity, b.velocity)
        assert not torch.equal(a.velocity, c.velocity)

    @given(st.integers(-9, 9), st.integers(-9, 9))
    @settings(max_examples=20, deadline=None)
    def test_free_mass_moves_against_the_grid(self, east: int, north: int) -> None:
        field = torch.arange(1.0, 65).view(8, 8)
        moved = shifted_tensor(field, (east, north))
        for i in range(8):
            for j in range(8):
                inside = 0 <= i + east < 8 and 0 <= j + north < 8
                assert moved[i, j] == (field[i + east, j + north] if inside else 0)

    @pytest.mark.parametrize("frame", ["ego", "ground"])
    def test_free_mass_stays_in_its_place_and_ages(self, frame: Frame) -> None:
        free = torch.zeros(2, 8, 8)
        free[1, 5, 5] = 0.95
        parameters = replace(SMALL, frame=frame)
        _, dogma = follow([free, torch.zeros(2, 8, 8)], (1, 2), parameters)[-1]
        assert dogma.mass[1].nonzero().tolist() == [[4, 3]]
        assert dogma.mass[1, 4, 3].item() == pytest.approx(0.95 * 0.9)

    def test_cells_and_rim(self) -> None:
        position = torch.tensor([[0.0, 7.999, 3.5, -0.001, 8.0, 500.0], [0.0, 7.999, 4.5, 3.0, 3.0, -500.0]])
        count = torch.bincount(cell_number(position, 8), minlength=100)
        inner = without_rim(count, 8)
        assert inner.nonzero().tolist() == [[0, 0], [3, 4], [7, 7]]
        assert count.sum() - inner.sum() == 3
        assert torch.equal(without_rim(with_rim(inner), 8), inner)


class TestScenes:
    grid = GridSpec(cells=64)
    parameters = replace(GROUND, persistent=100_000, births=20_000)

    @pytest.mark.parametrize("velocity", [(5.0, 0.0), (-3.0, 4.0)])
    def test_moving_block_is_found_within_ten_frames(self, velocity: tuple[float, float]) -> None:
        grids, block = block_scene(self.grid, 10, velocity)
        _, dogma = follow(grids, parameters=self.parameters, grid=self.grid)[-1]
        mean = dogma.velocity[:, block].mean(1)
        assert torch.dist(mean, torch.tensor(velocity)) < 0.5
        assert is_moving(dogma.velocity, dogma.covariance)[block].float().mean() > 0.7

    def test_standing_block_stands(self) -> None:
        grids, block = block_scene(self.grid, 10, (0.0, 0.0))
        _, dogma = follow(grids, parameters=self.parameters, grid=self.grid)[-1]
        assert dogma.velocity[:, block].mean(1).norm() < 0.2
        assert is_moving(dogma.velocity, dogma.covariance)[block].float().mean() < 0.03

    @pytest.mark.parametrize(("frame", "expected"), [("ground", (0.0, 0.0)), ("ego", (-10 / 3, 0.0))])
    def test_standing_block_and_moving_ego(self, frame: Frame, expected: tuple[float, float]) -> None:
        # One cell a frame is 10/3 m/s towards the east.
        grids, block = block_scene(self.grid, 12, (0.0, 0.0), ego_cells=(1, 0), length=2.0)
        _, dogma = follow(grids, (1, 0), replace(self.parameters, matching=0, frame=frame), self.grid)[-1]
        assert torch.dist(dogma.velocity[:, block].mean(1), torch.tensor(expected)) < 0.5

    def test_parameters_of_the_paper_find_the_block_too(self) -> None:
        """Their births N(0, 4 m/s) pull its speed towards 0."""
        grids, block = block_scene(self.grid, 10, (5.0, 0.0))
        parameters = replace(self.parameters, **PAPER_MODEL)
        _, dogma = follow(grids, parameters=parameters, grid=self.grid)[-1]
        assert torch.dist(dogma.velocity[:, block].mean(1), torch.tensor([4.0, 0.0])) < 0.5

    @pytest.mark.parametrize("device", DEVICES)
    def test_devices_agree_statistically(self, device: str) -> None:
        grids, block = block_scene(self.grid, 10, (5.0, 0.0))
        _, here = follow(grids, parameters=self.parameters, grid=self.grid, seed=1)[-1]
        _, there = follow(grids, parameters=self.parameters, grid=self.grid, seed=2, device=device)[-1]
        assert (here.mass - there.mass.cpu()).abs().mean() < 0.01
        assert torch.dist(here.velocity[:, block].mean(1), there.velocity.cpu()[:, block].mean(1)) < 0.3


class TestBadInput:
    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"persistent": 0}, "at least one particle: persistent is 0"),
            ({"births": 0}, "births is 0"),
            ({"survival": 1.5}, "survival"),
            ({"discount": 0.0}, "discount"),
            ({"birth": float("nan")}, "birth of"),
            ({"velocity_noise": -1.0}, "velocity_noise"),
            ({"birth_standing": 2.0}, "birth_standing"),
            ({"period": 0.0}, "period"),
            ({"frame": "world"}, "'ego' or 'ground'"),
            ({"matching": 3}, "frame ground"),
            ({"matching_sharpness": -1.0}, "matching_sharpness"),
            ({"neighbourhood": -1}, "neighbourhood"),
        ],
    )
    def test_parameters(self, change: dict[str, Any], message: str) -> None:
        with pytest.raises(UserError, match=message):
            replace(PAPER, **change)

    @pytest.mark.parametrize("mass", [float("nan"), -0.1, 0.7])
    def test_no_masses(self, mass: float) -> None:
        measured = torch.zeros(2, 8, 8)
        measured[:, 3, 3] = mass
        with pytest.raises(ValueError, match="numbers of at least 0 that sum to at most 1"):
            follow([measured])

    @pytest.mark.parametrize("shape", [(2, 8, 9), (1, 8, 8), (2, 16, 16), (8, 8)])
    def test_shape_of_measurement(self, shape: tuple[int, ...]) -> None:
        with pytest.raises(ValueError, match=r"measured masses \(2,8,8\)"):
            follow([torch.zeros(shape)])

    def test_shift_and_state(self) -> None:
        with pytest.raises(ValueError, match="shift"):
            step(initial_state(SMALL, TINY), torch.zeros(2, 8, 8), (1, 2, 3), SMALL, TINY, seeded())
        with pytest.raises(ValueError, match=r"positions and velocities \(2,300\)"):
            step(initial_state(PAPER, TINY), torch.zeros(2, 8, 8), (1, 2), SMALL, TINY, seeded())
