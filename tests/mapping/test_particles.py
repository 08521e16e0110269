"""The particle filter: equations by hand, invariants, known scenes, bad input."""

from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from envpred.errors import UserError
from envpred.mapping.dogma import is_moving
from envpred.mapping.geometry import GridSpec
from envpred.mapping.particle_state import GROUND, ParticleFilterParameters, ParticleState, initial_state
from envpred.mapping.particles import (
    DogmaGrid,
    Particles,
    adopt,
    apportion,
    box_sum,
    cell_number,
    combine,
    give_birth,
    moments,
    normal,
    over_neighbours,
    predict,
    predict_free,
    predict_occupied,
    resample,
    shifted,
    sort_by_cell,
    split_occupied,
    step,
    with_rim,
    without_rim,
)

Frame = Literal["ego", "ground"]
PAPER = ParticleFilterParameters()
PAPER_MODEL: dict[str, Any] = {
    name: getattr(PAPER, name)
    for name in ("survival", "birth", "birth_velocity", "velocity_noise", "adoption", "neighbourhood")
}
SMALL = replace(PAPER, persistent=300, births=40)
TINY = GridSpec(cells=8)
NOWHERE = torch.zeros(0, dtype=torch.int64)
NOBODY = Particles(torch.zeros(2, 0), NOWHERE, NOWHERE.int(), torch.zeros(2, 0), torch.zeros(100, dtype=torch.int64))
DEVICES = ["cpu", pytest.param("cuda", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA"))]


def seeded(seed: int = 0, device: str = "cpu") -> torch.Generator:
    return torch.Generator(device).manual_seed(seed)


def masses(occupied: torch.Tensor, free: float = 0.95) -> torch.Tensor:
    """Measurement (2, H, W): `occupied` cells 0.95 occupied, the others `free`."""
    return torch.stack((0.95 * occupied, free * (1 - occupied)))


def random_masses(seed: int, cells: int) -> torch.Tensor:
    """Measurement of which a third is occupied, a third free, a third unknown."""
    kind = torch.randint(3, (cells, cells), generator=seeded(seed))
    return 0.95 * torch.stack((kind == 1, kind == 2)).float()


def follow(
    grids: list[torch.Tensor],
    shift: tuple[int, int] = (0, 0),
    parameters: ParticleFilterParameters = SMALL,
    grid: GridSpec = TINY,
    seed: int = 0,
    device: str = "cpu",
) -> list[tuple[ParticleState, DogmaGrid]]:
    """States and dynamic grids of a sequence of measurements."""
    state, generator, out = initial_state(parameters, grid, device), seeded(seed, device), []
    for measured in grids:
        state, dogma = step(state, measured.to(device), shift, parameters, grid, generator)
        out.append((state, dogma))
    return out


class TestEquations:
    def test_constant_velocity_without_noise(self) -> None:  # (14)
        quiet = replace(PAPER, persistent=1, position_noise=0, velocity_noise=0)
        state = replace(
            initial_state(quiet, TINY), position=torch.tensor([[2.0], [3.0]]), velocity=torch.tensor([[5.0], [-10.0]])
        )
        position, velocity = predict(state, (1, 2), quiet, TINY, seeded())
        # 0.1 s at 5 and -10 m/s is 0.5 and -1 m, which is 1.5 and -3 cells of 1/3 m.
        torch.testing.assert_close(position, torch.tensor([[3.5], [0.0]]))
        torch.testing.assert_close(velocity, torch.tensor([[5.0], [-10.0]]))
        position, _ = predict(state, (1, 2), replace(quiet, frame="ground"), TINY, seeded())
        torch.testing.assert_close(position, torch.tensor([[2.5], [-2.0]]))

    def test_process_noise_has_the_stated_deviation_in_metres(self) -> None:
        still = initial_state(PAPER, TINY)
        position, velocity = predict(still, (0, 0), PAPER, TINY, seeded())
        torch.testing.assert_close(position.std(1) * TINY.resolution, torch.tensor([0.02, 0.02]), rtol=0.02, atol=0)
        torch.testing.assert_close(velocity.std(1), torch.tensor([0.8, 0.8]), rtol=0.02, atol=0)
        together = torch.corrcoef(torch.cat((position, velocity))) - torch.eye(4)
        assert together.abs().max() < 0.02

    def test_predicted_occupied_is_the_sum_of_weights_with_its_cap(self) -> None:  # (39)
        predicted = predict_occupied(torch.tensor([0, 3, 10]), torch.tensor(0.2), PAPER)
        torch.testing.assert_close(predicted, torch.tensor([0.0, 0.594, 0.99]))

    def test_predicted_free_ages_and_leaves_room(self) -> None:  # (62)
        predicted = predict_free(torch.tensor([0.8, 0.3]), torch.tensor([0.594, 0.594]), PAPER)
        torch.testing.assert_close(predicted, torch.tensor([0.406, 0.27]))

    def test_dempster(self) -> None:  # (63): K = 0.6 * 0.95 = 0.57
        mass = combine(torch.tensor([[0.3]]), torch.tensor([[0.6]]), torch.tensor([[[0.95]], [[0.0]]]))
        expected = [(0.3 * 0.05 + 0.1 * 0.95 + 0.3 * 0.95) / 0.43, 0.6 * 0.05 / 0.43]
        torch.testing.assert_close(mass.flatten(), torch.tensor(expected))

    def test_born_and_persisting(self) -> None:  # (67), (68)
        born, persisting = split_occupied(torch.tensor([0.9, 0.95]), torch.tensor([0.3, 0.0]), PAPER)
        torch.testing.assert_close(born, torch.tensor([0.9 * 0.014 / 0.314, 0.95]))
        torch.testing.assert_close(persisting, torch.tensor([0.9 - 0.9 * 0.014 / 0.314, 0.0]))

    def test_moments_of_three_particles(self) -> None:
        velocity = torch.tensor([[1.0, 3.0, 2.0, 7.0], [0.0, 4.0, 5.0, -7.0]])
        position = torch.tensor([[2.5, 2.1, 2.9, 0.5], [5.5, 5.2, 5.7, 0.5]])
        mean, covariance = moments(sort_by_cell(position, velocity, 8), 8)
        np.testing.assert_allclose(mean[:, 2, 5], velocity[:, :3].mean(1), rtol=1e-6)
        wanted = np.cov(velocity[:, :3].numpy(), bias=True)
        np.testing.assert_allclose(covariance[:, 2, 5], wanted[[0, 0, 1], [0, 1, 1]], rtol=1e-6)
        assert mean[:, 0, 0].tolist() == [7, -7]
        assert covariance[:, 0, 0].tolist() == [0, 0, 0]
        assert mean.count_nonzero() == 4

    def test_newborns_follow_rho_b(self) -> None:  # (74)-(80)
        born = torch.zeros(8, 8)
        born[1, 2], born[6, 7] = 0.3, 0.1
        newborn = give_birth(born, replace(PAPER, births=40_000), seeded())
        assert without_rim(newborn.count, 8)[[1, 6], [2, 7]].tolist() == [30_000, 10_000]
        corner = newborn.position.floor()
        assert (corner[:, :30_000] == torch.tensor([[1], [2]])).all()
        assert (corner[:, 30_000:] == torch.tensor([[6], [7]])).all()
        inside = newborn.position - corner
        torch.testing.assert_close(inside.mean(1), torch.full((2,), 0.5), atol=0.01, rtol=0)
        torch.testing.assert_close(newborn.velocity.std(1), torch.full((2,), 4.0), rtol=0.02, atol=0)

    def test_some_newborns_stand(self) -> None:
        newborn = give_birth(torch.ones(8, 8), replace(PAPER, birth_standing=0.3), seeded())
        assert (newborn.velocity == 0).all(0).float().mean().item() == pytest.approx(0.3, abs=0.02)

    def test_cells_that_enter_have_no_prior_in_the_ground_frame(self) -> None:
        quiet = replace(SMALL, position_noise=0, velocity_noise=0, frame="ground")
        state = replace(
            initial_state(quiet, TINY),
            position=torch.full((2, 300), 7.5),
            velocity=torch.tensor([[10.0], [0.0]]).repeat(1, 300),  # three cells a frame
            weight=torch.tensor(0.003),
        )
        _, dogma = step(state, torch.zeros(2, 8, 8), (3, 0), quiet, TINY, seeded())
        assert dogma.mass.count_nonzero() == 0
        _, dogma = step(
            replace(state, position=state.position - 4), torch.zeros(2, 8, 8), (1, 0), quiet, TINY, seeded()
        )
        assert dogma.mass[0].nonzero().tolist() == [[5, 3]]


class TestSampling:
    @given(st.lists(st.floats(0, 10), min_size=1, max_size=30), st.integers(1, 200), st.integers(0, 99))
    @settings(max_examples=40, deadline=None)
    def test_apportion_is_fair_and_exact(self, share: list[float], total: int, seed: int) -> None:
        fair = torch.tensor(share, dtype=torch.float64)
        fair[0] += 1e-9  # callers see to it that there is something to share
        count = apportion(fair, total, seeded(seed))
        assert count.sum() == total
        assert ((count - fair / fair.sum() * total).abs() < 1 + 1e-6).all()

    def test_children_come_from_their_own_cell_evenly(self) -> None:
        position = torch.tensor([[1.5] * 4 + [3.5] * 2, [1.5] * 4 + [3.5] * 2])
        velocity = torch.arange(12.0).view(2, 6)
        persistent = sort_by_cell(position, velocity, 8)
        persisting, born = torch.zeros(8, 8), torch.zeros(8, 8)
        persisting[1, 1], persisting[3, 3] = 0.5, 1.0
        position, drawn, weight = resample(persistent, persisting, NOBODY, born, seeded())
        assert weight.item() == pytest.approx(1.5 / 6)
        assert sorted(drawn[0].tolist())[2:] == [
            4,
            4,
            5,
            5,
        ]  # two of the first cell's four, each of the other's two twice
        assert len(set(drawn[0, :2].tolist())) == 2
        assert (position[0, :2] == 1.5).all()

    def test_numbers_from_the_table_are_normal_and_new_every_time(self) -> None:
        generator = seeded()
        first, second = normal(50_000, generator), normal(50_000, generator)
        for numbers in (first, second):
            assert numbers.mean().abs() < 0.02
            assert numbers.std().item() == pytest.approx(1, abs=0.02)
            assert (numbers.abs() > 1.96).float().mean().item() == pytest.approx(0.05, abs=0.005)
            assert torch.corrcoef(numbers)[0, 1].abs() < 0.02
        assert torch.corrcoef(torch.stack((first[0], second[0])))[0, 1].abs() < 0.02

    def test_a_particle_by_particle_filter_agrees(self) -> None:
        """The simple version: one loop over children, one over cells."""
        position, velocity = 8 * torch.rand(2, 400, generator=seeded(1)), torch.randn(2, 400, generator=seeded(2))
        particles, persisting = sort_by_cell(position, velocity, 8), torch.rand(8, 8, generator=seeded(3))
        mean, covariance = moments(particles, 8)
        cell = position.floor().long()
        share = persisting[cell[0], cell[1]].double()
        for i, j in np.ndindex(8, 8):
            inside = ((cell[0] == i) & (cell[1] == j)).numpy()
            share[inside] /= max(inside.sum(), 1)
            if inside.any():
                own = velocity.numpy()[:, inside].astype(np.float64)
                np.testing.assert_allclose(mean[:, i, j], own.mean(1), atol=1e-6)
                np.testing.assert_allclose(covariance[:, i, j], np.cov(own, bias=True)[[0, 0, 1], [0, 1, 1]], atol=1e-5)
        drawn, _, _ = resample(particles, persisting, NOBODY, torch.zeros(8, 8), seeded(4))
        u = torch.rand((), generator=seeded(4), dtype=torch.float64).item()
        order, reached, wanted = np.lexsort((cell[1], cell[0])), 0.0, []
        for k in order:
            before = np.floor(reached + u)
            reached += share[k].item() / share.sum().item() * 400
            wanted += [position[:, k].numpy()] * int(np.floor(reached + u) - before)
        np.testing.assert_array_equal(drawn.T[: len(wanted)], np.array(wanted)[:400])

    def test_unbiased_over_seeds(self) -> None:
        velocity = torch.tensor([[0.0, 1.0, 2.0], [0.0, 0.0, 0.0]])
        persistent = sort_by_cell(torch.full((2, 3), 2.5), velocity, 8)
        persisting = torch.zeros(8, 8)
        persisting[2, 2] = 0.2
        born = torch.zeros(8, 8)
        born[4, 4] = 0.4  # two thirds of the mass: one child is left for three parents
        newborn = give_birth(born, replace(PAPER, births=5), seeded())
        parents = []
        for seed in range(300):
            position, drawn, _ = resample(persistent, persisting, newborn, born, seeded(seed))
            parents += drawn[0, position[0] == 2.5].tolist()
        assert len(parents) == 300
        assert np.bincount(np.array(parents, int), minlength=3) == pytest.approx([100, 100, 100], abs=30)


class TestNeighbours:
    """What the paper has not: velocities that are handed on and averaged within a body."""

    def test_box_sum_by_hand(self) -> None:
        field = torch.zeros(2, 5, 6)
        field[0, 1, 2], field[1, 4, 5] = 3.0, 2.0
        sums = box_sum(field, 1)
        assert sums[0].nonzero().tolist() == [[i, j] for i in (0, 1, 2) for j in (1, 2, 3)]
        assert sums[0].max() == 3
        assert sums[1].nonzero().tolist() == [[3, 4], [3, 5], [4, 4], [4, 5]]

    def test_moments_of_neighbours_are_those_of_their_particles_together(self) -> None:
        velocity = torch.randn(2, 60, generator=seeded(1))
        position = torch.tensor([[2.5] * 20 + [3.5] * 40, [4.5] * 60])
        mean, covariance = moments(sort_by_cell(position, velocity, 8), 8)
        weight = torch.zeros(8, 8)
        weight[2, 4], weight[3, 4] = 20, 40
        mean, covariance = over_neighbours(mean, covariance, weight, 1)
        for i in (2, 3):
            np.testing.assert_allclose(mean[:, i, 4], velocity.mean(1), rtol=1e-4, atol=1e-5)
            wanted = np.cov(velocity.numpy(), bias=True)
            np.testing.assert_allclose(covariance[:, i, 4], wanted[[0, 0, 1], [0, 1, 1]], rtol=1e-4, atol=1e-5)
        assert mean.count_nonzero() == 4  # cells without particles have no velocity

    def adopting(self, occupied_before: list[int], measured_now: list[int]) -> torch.Tensor:
        """Velocities east by cell (8,) of a row that was occupied in some cells and is now in others, after handing on.

        Two kinds of particles: cells 1 to 4 hold standing ones, and cell 5 some that come from cell 4.
        """
        parameters = replace(SMALL, frame="ground", adoption=50, adoption_reach=1.0)
        before, measured = torch.zeros(2, 8, 8), torch.zeros(2, 8, 8)
        before[1], measured[1] = 0.99, 0.95
        before[0, occupied_before, 3], measured[0, measured_now, 3] = 0.99, 0.95
        before[1, occupied_before, 3], measured[1, measured_now, 3] = 0.0, 0.0
        position = torch.tensor([[1.5, 2.5, 3.5, 4.5, 5.2] * 20, [3.5] * 100])
        velocity = torch.tensor([[0.0, 0.0, 0.0, 0.0, 10 / 3] * 20, [0.0] * 100])
        particles = sort_by_cell(position, velocity, 8)
        adopt(particles, before, measured, parameters, TINY, seeded())
        return moments(particles, 8)[0][0, :, 3]

    def test_a_front_hands_its_velocity_on(self) -> None:
        east = self.adopting([1, 2, 3, 4], [2, 3, 4, 5])
        assert (east[2:5] > 0.5).all()
        assert east[1] == 0  # further away than the reach

    def test_what_has_not_moved_hands_nothing_on(self) -> None:
        assert self.adopting([1, 2, 3, 4, 5], [1, 2, 3, 4, 5])[1:5].count_nonzero() == 0

    def test_adoption_is_of_the_paper_only_if_asked_for(self) -> None:
        assert PAPER.adoption == PAPER.neighbourhood == 0


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
        moved = shifted(field, (east, north))
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


def block_scene(
    grid: GridSpec,
    frames: int,
    velocity: tuple[float, float],
    ego_cells: tuple[int, int] = (0, 0),
    length: float = 4.0,
) -> tuple[list[torch.Tensor], torch.Tensor]:
    """A block of `length` x 2 m in free space, moving relative to the ground, on a grid that moves by `ego_cells`.

    Returns the measurements and the cells that the block covers in the last frame.
    """
    centre = (torch.arange(grid.cells) - grid.half) * grid.resolution
    grids = []
    for t in range(frames):
        where = [
            centre - offset - v * PAPER.period * (t - frames + 1) + step_cells * grid.resolution * (t - frames + 1)
            for offset, v, step_cells in zip((3.0, -2.0), velocity, ego_cells, strict=True)
        ]
        block = (where[0].abs()[:, None] <= length / 2) & (where[1].abs()[None, :] <= 1)
        grids.append(masses(block.float()))
    return grids, block


class TestScenes:
    grid = GridSpec(cells=64)
    parameters = replace(GROUND, persistent=100_000, births=20_000)

    @pytest.mark.parametrize("velocity", [(5.0, 0.0), (-3.0, 4.0)])
    def test_moving_block_is_found_within_ten_frames(self, velocity: tuple[float, float]) -> None:
        grids, block = block_scene(self.grid, 10, velocity)
        _, dogma = follow(grids, parameters=self.parameters, grid=self.grid)[-1]
        mean = dogma.velocity[:, block].mean(1)
        assert torch.dist(mean, torch.tensor(velocity)) < 0.5
        assert is_moving(dogma.velocity, dogma.covariance)[block].float().mean() > 0.6

    def test_standing_block_stands(self) -> None:
        grids, block = block_scene(self.grid, 10, (0.0, 0.0))
        _, dogma = follow(grids, parameters=self.parameters, grid=self.grid)[-1]
        assert dogma.velocity[:, block].mean(1).norm() < 0.2
        assert is_moving(dogma.velocity, dogma.covariance)[block].float().mean() < 0.03

    @pytest.mark.parametrize(("frame", "expected"), [("ground", (0.0, 0.0)), ("ego", (-10 / 3, 0.0))])
    def test_standing_block_and_moving_ego(self, frame: Frame, expected: tuple[float, float]) -> None:
        # One cell a frame is 10/3 m/s towards the east.
        grids, block = block_scene(self.grid, 12, (0.0, 0.0), ego_cells=(1, 0), length=2.0)
        _, dogma = follow(grids, (1, 0), replace(self.parameters, adoption=0, frame=frame), self.grid)[-1]
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
            ({"adoption": 4}, "frame ground"),
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
