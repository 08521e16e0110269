"""Velocities by matching: displacements by hand, what counts as moved, and what the filter makes of it."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from envpred.mapping.dogma import is_moving
from envpred.mapping.geometry import GridSpec
from envpred.mapping.matching import TILE, Matches, match
from envpred.mapping.particle_state import GROUND
from envpred.mapping.particles.cells import cell_number, sort_by_cell
from envpred.mapping.particles.moments import moments
from envpred.mapping.particles.update import weigh
from envpred.mapping.shift import shifted_tensor
from tests.mapping.filters import block_scene, follow, masses, seeded

GRID = GridSpec(cells=48)
CELL_SPEED = GRID.resolution / (GROUND.matching * GROUND.period)  # m/s of a displacement by one cell


def car(east: int, north: int, length: int = 12, width: int = 6) -> torch.Tensor:
    """m(O) - m(F) of a car in free space, its corner at a cell."""
    grid = torch.full((GRID.cells, GRID.cells), -0.95)
    grid[east : east + length, north : north + width] = 0.95
    return grid


def best(matches: Matches, cell: tuple[int, int]) -> torch.Tensor:
    """The displacement in cells that agrees best around `cell`."""
    score = matches.score[int(matches.tile[cell])]
    half = score.shape[-1] // 2
    return torch.stack(torch.unravel_index(score.argmax(), score.shape)) - half


class TestMatch:
    @given(st.integers(-10, 10), st.integers(-10, 10))
    @settings(max_examples=25, deadline=None)
    def test_the_displacement_of_a_car_agrees_best_everywhere_on_it(self, east: int, north: int) -> None:
        matches = match(car(18 + east, 21 + north), car(18, 21), GROUND, GRID)
        if max(abs(east), abs(north)) <= 1:
            assert len(matches.score) == 0  # no gain over standing still
            return
        for cell in ((18 + east, 21 + north), (29 + east, 26 + north), (24 + east, 23 + north)):
            assert best(matches, cell).tolist() == [east, north]

    def test_agreement_by_hand(self) -> None:
        """A car of 4 x 4 cells: its tile's window holds the car and the two cells around it."""
        matches = match(car(24, 24, 4, 4), car(20, 24, 4, 4), GROUND, GRID)
        score = matches.score[int(matches.tile[25, 25])]
        half = score.shape[-1] // 2
        square = 0.95**2
        assert score[half + 4, half].item() == pytest.approx(64 * square)
        # Four cells too few: the 16 of the car and, of those around it, the 2 x 4 that were car then, disagree.
        assert score[half, half].item() == pytest.approx((64 - 2 * (16 + 8)) * square)

    def test_standing_things_and_what_comes_into_sight_have_not_moved(self) -> None:
        standing, nothing_known = car(18, 21), torch.zeros(GRID.cells, GRID.cells)
        for then in (standing, nothing_known):
            matches = match(standing, then, GROUND, GRID)
            assert (matches.tile == -1).all()
            assert len(matches.score) == 0

    def test_few_changed_cells_count_as_noise(self) -> None:
        now = car(18, 21)
        then = now.clone()
        then[18, 21:26] = -0.95
        assert (match(now, then, GROUND, GRID).tile == -1).all()

    def test_a_car_that_passes_says_nothing_about_a_parked_one(self) -> None:
        parked = car(18, 30)
        now, then = torch.maximum(parked, car(18, 21)), torch.maximum(parked, car(12, 21))
        matches = match(now, then, GROUND, GRID)
        assert (matches.tile[18:30, 20:28] >= 0).all()
        # Tiles are 4 cells wide: those from 32 on hold nothing but the parked car.
        assert (matches.tile[:, 32:] == -1).all()

    def test_grids_that_are_no_whole_number_of_tiles(self) -> None:
        grid = GridSpec(cells=46)
        now, then = car(34, 34)[:46, :46], car(31, 34)[:46, :46]
        matches = match(now, then, GROUND, grid)
        assert matches.tile.shape == (46, 46)
        assert best(matches, (45, 38)).tolist() == [3, 0]

    def test_windows_at_the_border_see_nothing_beyond_it(self) -> None:
        matches = match(car(0, 0, 6), car(4, 0, 6), GROUND, GRID)
        assert best(matches, (0, 0)).tolist() == [-4, 0]

    def test_the_same_scene_elsewhere_matches_likewise(self) -> None:
        """Each place is judged by its own surroundings; elsewhere is whole tiles away."""
        now, then = car(18, 21), car(15, 20)
        here = match(now, then, GROUND, GRID)
        there = match(shifted_tensor(now, (TILE, -TILE)), shifted_tensor(then, (TILE, -TILE)), GROUND, GRID)
        cell = (20, 22)
        pair = here.score[int(here.tile[cell])], there.score[int(there.tile[cell[0] - TILE, cell[1] + TILE])]
        near = slice(7, -7)  # displacements that do not look beyond the grid's border
        torch.testing.assert_close(pair[0][near, near], pair[1][near, near])


class TestLikelihood:
    surface = Matches(torch.zeros(1, 1, dtype=torch.int64), torch.arange(25.0).view(1, 5, 5), 2.0)

    @pytest.mark.parametrize(
        ("velocity", "expected"),
        [
            ((1.0, 1.0), 24.0),  # two cells east and north: the last entry
            ((-1.0, -1.0), 0.0),
            ((0.0, 0.25), 12.5),  # half a cell north of the middle
            ((0.25, 0.0), 14.5),  # half a cell east
            ((0.25, -0.75), 13.0),
            ((9.0, 9.0), 24.0),  # faster than what is tried
        ],
    )
    def test_between_whole_cells(self, velocity: tuple[float, float], expected: float) -> None:
        log = self.surface.log_likelihood(torch.tensor(velocity)[:, None], torch.tensor([0]))
        assert log.item() == pytest.approx(expected - 24, abs=0.01)

    def test_each_particle_reads_the_surface_of_its_tile(self) -> None:
        score = torch.stack((torch.eye(3), -torch.eye(3)))
        log = Matches(torch.zeros(1, 1, dtype=torch.int64), score, 1.0).log_likelihood(
            torch.zeros(2, 2), torch.tensor([0, 1])
        )
        torch.testing.assert_close(log, torch.tensor([0.0, -1.0]))


class TestWeigh:
    def particles(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Half of the 400 in each of two cells stand, half drive at 4 cells in three frames; 100 in a third stand."""
        position = torch.tensor([[20.5] * 400 + [40.5] * 400 + [21.5] * 100, [22.5] * 900])
        velocity = torch.tensor([([0.0] * 200 + [4 * CELL_SPEED] * 200) * 2 + [0.0] * 100, [0.0] * 900])
        return position, velocity

    def test_likely_velocities_are_kept_where_something_moved_and_nowhere_else(self) -> None:
        particles = sort_by_cell(*self.particles(), GRID.cells)
        count = particles.count.clone()
        matches = match(car(18, 21), car(14, 21), GROUND, GRID)
        weigh(particles, matches, GROUND, seeded())
        mean = moments(particles, GRID.cells)[0][0]
        assert mean[20, 22] > 0.99 * 4 * CELL_SPEED
        assert mean[21, 22] == 0  # the unlikely ones of a cell without better ones stay
        assert mean[40, 22].item() == pytest.approx(2 * CELL_SPEED, rel=1e-5)
        assert torch.equal(particles.count, count)
        inside = cell_number(particles.position[:, particles.order], GRID.cells).long()
        assert torch.equal(inside, torch.repeat_interleave(count))  # each is still in its cell

    def test_shares_follow_the_likelihood(self) -> None:
        particles = sort_by_cell(*self.particles(), GRID.cells)
        tile = torch.full((GRID.cells, GRID.cells), -1)
        tile[20, 22] = 0
        score = torch.zeros(1, 31, 31)
        score[0, 15 + 4, 15] = 10.0
        matches = Matches(tile, score, 1 / CELL_SPEED)
        weigh(particles, matches, replace(GROUND, matching_sharpness=0.1), seeded())
        inside = cell_number(particles.position[:, particles.order], GRID.cells) == 21 * (GRID.cells + 2) + 23
        driving = (particles.velocity[0, particles.order] > 0)[inside].float().mean().item()
        odds = torch.tensor(1.0).exp().item()
        assert driving == pytest.approx(odds / (1 + odds), abs=0.01)

    def test_no_measurement_changes_nothing(self) -> None:
        particles = sort_by_cell(*self.particles(), GRID.cells)
        order = particles.order.clone()
        weigh(particles, match(car(18, 21), car(18, 21), GROUND, GRID), GROUND, seeded())
        assert torch.equal(particles.order, order)


class TestInTheFilter:
    parameters = replace(GROUND, persistent=50_000, births=10_000)
    grid = GridSpec(cells=64)

    def test_a_car_that_sets_off_from_behind_a_corner_is_fast_at_once(self) -> None:
        """Six frames after it is first seen, matching knows its speed, and survival alone does not."""
        error = {}
        for frames in (0, GROUND.matching):
            grids, block = block_scene(self.grid, 7, (9.0, 0.0), length=5.0)
            parameters = replace(self.parameters, matching=frames)
            _, dogma = follow(grids, parameters=parameters, grid=self.grid)[-1]
            error[frames] = (dogma.velocity[:, block] - torch.tensor([[9.0], [0.0]])).norm(dim=0).median().item()
        assert error[GROUND.matching] < 0.6
        assert error[0] > 2 * error[GROUND.matching]

    @pytest.mark.parametrize("ego", [(1, 0), (-2, 1)])
    def test_what_was_seen_moves_with_the_grid(self, ego: tuple[int, int]) -> None:
        """The ego drives, the block stands: nothing has moved."""
        grids, block = block_scene(self.grid, 8, (0.0, 0.0), ego_cells=ego)
        state, dogma = follow(grids, ego, self.parameters, self.grid)[-1]
        torch.testing.assert_close(state.seen[-1], grids[-1][0] - grids[-1][1])
        torch.testing.assert_close(state.seen[0], shifted_tensor(grids[-3][0] - grids[-3][1], (2 * ego[0], 2 * ego[1])))
        assert is_moving(dogma.velocity, dogma.covariance)[block].float().mean() < 0.03

    def test_nothing_is_kept_without_matching(self) -> None:
        state, _ = follow([masses(torch.ones(8, 8))])[-1]
        assert state.seen.shape == (0, 8, 8)


@pytest.mark.parametrize("fastest", [5.0, 15.0, 30.0])
def test_the_fastest_is_tried(fastest: float) -> None:
    parameters = replace(GROUND, matching_fastest=fastest)
    reach = match(car(18, 21), car(12, 21), parameters, GRID).score.shape[-1] // 2
    assert fastest <= reach * CELL_SPEED < fastest + 2 * CELL_SPEED
