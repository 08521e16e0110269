"""Where the ego will be: circles and brakes by hand, spreads, plans."""

import numpy as np
import pytest
import torch

from envpred.errors import UserError
from envpred.mapping.ego_motion import (
    EgoMotion,
    body_steps,
    cell_weights,
    drive_on,
    ego_futures,
    extrapolate,
    in_cells,
    planned,
)
from envpred.mapping.geometry import FloatArray

CELL, PERIOD = 1 / 3, 0.1
MOTION = EgoMotion()


def straight(speeds: list[float], heading: float = 0.0) -> FloatArray:
    """Poses (T, 3) of an ego that drives `speeds` in m/s from one frame to the next."""
    way = np.concatenate([[0.0], np.cumsum(speeds)]) * PERIOD / CELL
    return np.stack([way * np.cos(heading), way * np.sin(heading), np.full(len(way), heading)], axis=1)


def futures(poses: FloatArray, count: int = 1, seed: int = 0, motion: EgoMotion = MOTION) -> FloatArray:
    times = PERIOD * np.arange(len(poses), dtype=np.float64)
    return ego_futures(poses, times, 15, count, np.random.default_rng(seed), motion, CELL)


@pytest.mark.parametrize("rate", [0.0, 0.02, -0.3])
def test_constant_speed_and_turn_rate_are_continued_exactly(rate: float) -> None:
    """A drive on a circle, its heading passing through pi: the chord of each step is turned with it."""
    headings = 3.0 + rate * np.arange(20)
    chords = np.exp(1j * (headings[:-1] + rate / 2)) * 2.5
    places = np.concatenate([[0], np.cumsum(chords)])
    wrapped = np.angle(np.exp(1j * headings))
    poses = np.stack([places.real, places.imag, wrapped], axis=1)
    found = extrapolate(torch.from_numpy(poses[None, :5]), 15)
    torch.testing.assert_close(found[..., :2], torch.from_numpy(poses[None, 5:, :2]))
    assert futures(poses[:5])[0, :, :2] == pytest.approx(poses[5:, :2])


def test_one_pose_stands_still() -> None:
    pose = torch.tensor([[[1.0, 2.0, 3.0]]])
    torch.testing.assert_close(extrapolate(pose, 4), pose.expand(1, 4, 3))
    assert (futures(pose[0].double().numpy(), 4) == [1.0, 2.0, 3.0]).all()


def test_steps_in_the_body_frame_and_back() -> None:
    forward, left = torch.tensor([3.0, 2.0, 1.0]), torch.tensor([0.5, 0.0, -0.5])
    heading = 3.0 + 0.4 * torch.arange(1, 4)
    way = drive_on(torch.tensor([7.0, -2.0, 3.0]), forward, left, heading, heading - 0.2)
    back = body_steps(torch.cat([torch.tensor([[7.0, -2.0, 3.0]]), way]))
    torch.testing.assert_close(torch.stack(back), torch.stack([forward, left, torch.full((3,), 0.4)]))


def test_a_constant_acceleration_is_continued_by_what_is_kept_of_it() -> None:
    # Steps of 6.05, 6.15, 6.25, 6.35 m/s: 1 m/s^2, and 6.4 m/s at the last pose.
    poses = straight([6.05, 6.15, 6.25, 6.35])
    whole = futures(poses, motion=EgoMotion(kept=1.0))[0, :, 0] - poses[-1, 0]
    t = PERIOD * np.arange(1, 16)
    assert whole == pytest.approx((6.4 * t + t**2 / 2) / CELL)
    # Of half of it: the mean, 6.2 m/s, is that of 0.2 s before the last pose.
    half = futures(poses, motion=EgoMotion(kept=0.5))[0, :, 0] - poses[-1, 0]
    assert half == pytest.approx((6.3 * t + t**2 / 4) / CELL)
    # 20 m/s^2 are noise of the poses: 3 are taken.
    noisy = futures(straight([4.0, 6.0, 8.0, 10.0]), motion=EgoMotion(kept=1.0))[0]
    assert noisy[1, 0] - noisy[0, 0] == pytest.approx((7.0 + 3 * 0.35) * PERIOD / CELL)


def test_who_brakes_stops() -> None:
    poses = straight([2.0, 1.7, 1.4, 1.1], heading=1.0)
    way = futures(poses, 16, motion=EgoMotion(kept=1.0))
    along = (way[..., :2] - poses[-1, :2]) @ [np.cos(1.0), np.sin(1.0)]
    # 0.95 m/s at -3 m/s^2: 0.15 m, and standing from 0.32 s on.
    assert np.diff(along, axis=1).min() > -0.05, "but for the turn, nobody drives back"
    one = futures(poses, motion=EgoMotion(kept=1.0))
    assert np.linalg.norm(one[0, [3, 14], :2] - poses[-1, :2], axis=1) * CELL == pytest.approx([0.95**2 / 6] * 2)


def test_who_stands_stands() -> None:
    poses = np.tile([40.2, 7.9, 2.0], (5, 1))
    assert (futures(poses, 16) == poses[-1]).all()
    jittered = poses + np.random.default_rng(0).normal(0, 0.01, (5, 3))  # 3 mm
    assert (futures(jittered, 16) == jittered[-1]).all()
    creeping = futures(straight([0.3] * 4), 16)
    assert creeping[:, -1, 0].min() > straight([0.3] * 4)[-1, 0] + 0.5


def beating(phase: float, frames: int = 40, speed: float = 12.0) -> tuple[FloatArray, FloatArray]:
    """Poses (T, 3) of the last fixes, 10 ms apart, before scans 103.6 ms apart, and the scans' times (T,)."""
    times = 0.1036 * np.arange(frames, dtype=np.float64)
    fixes = np.floor(times / 0.01 + phase) * 0.01
    return np.stack([fixes * speed / CELL, np.zeros(frames), np.zeros(frames)], axis=1), times


@pytest.mark.parametrize("phase", [0.1, 0.37, 0.9])
def test_the_beat_of_the_poses_clock_goes_on(phase: float) -> None:
    """Steps are 10 or 11 fixes; where the beat cannot be told, futures are divided, and a share has it right."""
    poses, times = beating(phase)
    sure, off, blind = 0, 0.0, 0.0
    for now in range(5, 25):
        shown = poses[now - 5 : now], times[now - 5 : now]
        one, many, without = (
            ego_futures(*shown, 15, count, np.random.default_rng(0), motion, CELL)[:, 0, 0]
            for count, motion in ((1, MOTION), (16, MOTION), (1, EgoMotion(clock=0.0)))
        )
        assert (np.abs(many - poses[now, 0]) * CELL < 0.03).any()
        sure += int(np.abs(one[0] - poses[now, 0]) * CELL < 0.01)
        off += float(np.abs(many.mean() - poses[now, 0]))
        blind += float(np.abs(without[0] - poses[now, 0]))
    assert sure >= 14, "of 20"
    assert off < blind / 2
    with pytest.raises(UserError, match="clock of"):
        ego_futures(*shown, 15, 1, np.random.default_rng(0), EgoMotion(clock=0.3), CELL)


def test_the_spread_is_that_of_its_parameters_and_smaller_for_who_creeps() -> None:
    motion = EgoMotion(position=0.1, sideways=0.05, speed=0.5, acceleration=0.0, lateral=0.0)
    many = futures(straight([10.0] * 4), 400, motion=motion)
    t = PERIOD * np.arange(1, 16)
    assert many[..., 0].std(0) * CELL == pytest.approx(np.sqrt(0.1**2 + (0.5 * t) ** 2), rel=0.15)
    assert many[..., 1].std(0) * CELL == pytest.approx(np.full(15, 0.05), rel=0.02)
    assert many[..., :2].mean(0) == pytest.approx(futures(straight([10.0] * 4))[0, :, :2], abs=0.02)
    slow = futures(straight([0.5] * 4), 400, motion=motion)  # a quarter of 2 m/s
    assert slow[..., 1].std(0) * CELL == pytest.approx(np.full(15, 0.05 / 4), rel=0.02)
    turning = futures(straight([10.0] * 4), 400, motion=EgoMotion(lateral=1.0))  # 1 m/s^2 by 10 m/s
    assert turning[..., 2].std(0) == pytest.approx(0.1 * t, rel=0.02)


def test_the_same_seed_gives_the_same_futures_and_another_others() -> None:
    poses = straight([8.0] * 4)
    assert (futures(poses, 16, 3) == futures(poses, 16, 3)).all()
    assert (futures(poses, 16, 3) != futures(poses, 16, 4)).any()


def test_a_plan_is_taken_as_it_is_and_a_short_or_broken_one_refused() -> None:
    plan = np.arange(60, dtype=np.float64).reshape(20, 3)
    assert (planned(plan, 15) == plan[None, :15]).all()
    with pytest.raises(UserError, match="14 poses, 15 frames"):
        planned(plan[:14], 15)
    with pytest.raises(UserError, match="finite"):
        planned(np.full((20, 3), np.nan), 15)
    with pytest.raises(UserError, match=r"\(N, 3\)"):
        planned(plan[:, :2], 15)
    metres = in_cells(np.array([[10.0, 20.0, 0.7]]), np.array([9.0, 22.0]), 0.5)
    assert metres.tolist() == [[2.0, -4.0, 0.7]]


@pytest.mark.parametrize("bad", [{"speed": -1.0}, {"full_speed": 0.0}, {"kept": float("nan")}, {"noise": 0.0}])
def test_motions_that_make_no_sense_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(UserError, match=next(iter(bad))):
        EgoMotion(**bad)


def test_few_futures_count_by_how_many_come_to_their_cell() -> None:
    """Three of four are in cell 0, where half of many are; cell 2 is rare, cell 5 is not, and nobody is there."""
    futures, many = np.zeros((4, 3, 3)), np.zeros((100, 2, 3))
    futures[3, :, 0] = 0.6  # rounds to cell 1
    many[:50, 0, 0], many[99, 0, 0] = 1.2, 2.0
    many[:90, 1, 0], many[90:, 1, 0] = 0.2, 5.0
    weights = cell_weights(futures, many)
    assert weights[:, 0] == pytest.approx(np.array([49 / 3, 49 / 3, 49 / 3, 50]) / 99)
    assert (weights[:, 1] == 0.25).all(), "a tenth of the probability lies where no future is"
    assert (weights[:, 2] == 0.25).all(), "further than many reach"


def test_the_weights_of_a_drive_are_the_same_whatever_futures_are_drawn() -> None:
    """The chance of each cell 0.1 s ahead is that of many futures, for every seed of the few."""
    poses = np.array([[2.9 * k, 0.1, 0.0] for k in range(5)])  # 9.7 m/s, to the border of two cells at 14.5
    times, motion = 0.1 * np.arange(5, dtype=np.float64), EgoMotion(clock=0.0, speed=1.0)
    chances = []
    many = ego_futures(poses, times, 1, 2048, np.random.default_rng(9), motion, 1 / 3)
    for seed in range(4):
        futures = ego_futures(poses, times, 1, 16, np.random.default_rng(seed), motion, 1 / 3)
        weights = cell_weights(futures, many)
        chances.append(float((weights[:, 0] * (futures[:, 0, 0] < 14.5)).sum()))
    assert 0.02 < chances[0] < 0.98
    assert chances == pytest.approx([float((many[:, 0, 0] < 14.5).mean())] * 4, abs=0.03)
