"""The steps of the particle filter: equations by hand, sampling, neighbours."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from envpred.mapping.particle_state import initial_state
from envpred.mapping.particles import step
from envpred.mapping.particles.births import give_birth
from envpred.mapping.particles.cells import sort_by_cell, without_rim
from envpred.mapping.particles.moments import box_sum, moments, over_neighbours
from envpred.mapping.particles.predict import predict, predict_free, predict_occupied
from envpred.mapping.particles.random import normal
from envpred.mapping.particles.resample import apportion, resample
from envpred.mapping.particles.update import combine, split_occupied
from tests.mapping.filters import NOBODY, PAPER, SMALL, TINY, seeded


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
    """What the paper has not: velocities that are averaged over neighbours."""

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
