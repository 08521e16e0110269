"""Where the ego will be: futures from the poses shown, with a spread that is estimated on drives, or from a plan.

A pose is x and y in cells of the drive's lattice and the heading in radians; a future is one pose a frame.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.special import ndtri
from torch import Tensor

from envpred.errors import UserError
from envpred.mapping.geometry import FloatArray

PHASES = 32  # of the poses' clock that are told apart
VISITED = 0.97  # share of the probability that lies in cells which futures visit, for their weights to stand for it


@dataclass(frozen=True)
class EgoMotion:
    """How the ego is taken to drive on: at constant turn rate and acceleration, with errors that grow with its speed.

    The defaults are what `ego_calibration.estimate` finds on two real and 24 simulated drives, each counting alike.
    Below `full_speed` all deviations shrink with the speed: who stands, stands.

    Args:
        position: standard deviation of where the ego is found at a future frame, metres along the way.
        sideways: the same across the way.
        speed: standard deviation of the present speed, m/s.
        acceleration: standard deviation of the acceleration, m/s^2.
        lateral: standard deviation of the acceleration across the way, m/s^2; the turn rate's is that by the speed.
        kept: share of the acceleration seen over the frames shown that is taken to last.
        full_speed: speed in m/s from which on the deviations are whole.
        standing: speed in m/s below which the ego is taken to stand, and its poses to jitter.
        largest: acceleration in m/s^2 beyond which what is seen counts as noise of the poses.
        clock: seconds between the fixes that poses are taken from (KITTI's OXTS: 0.01), or 0.  A scan gets a fix that
            is up to so much older, and at 10 m/s the steps of such poses beat by 10 cm; the beat goes on.
        noise: standard deviation of a step's length in metres, by which the beat is told from changes of speed.
    """

    position: float = 0.0025
    sideways: float = 0.004
    speed: float = 0.06
    acceleration: float = 0.76
    lateral: float = 0.6
    kept: float = 0.9
    full_speed: float = 2.0
    standing: float = 0.1
    largest: float = 3.0
    clock: float = 0.01
    noise: float = 0.01

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value >= 0 or (name in ("full_speed", "noise") and value == 0):
                raise UserError(f"{name} of the ego's motion must not be negative, nor full_speed or noise 0: {value}")

    def share(self, speed: FloatArray) -> FloatArray:
        """The share of the deviations that an ego of `speed` in m/s has, 0 to 1."""
        return np.minimum(np.abs(speed) / self.full_speed, 1.0)


class Seen(NamedTuple):
    """What the frames shown say of the ego's motion, for each of M phases of the clock that poses are taken from."""

    likelihood: FloatArray  # (M,), sums to 1
    speed: FloatArray  # (M,) at the last pose, m/s
    acceleration: FloatArray  # (M,) m/s^2, as much of it as is taken to last
    left: FloatArray  # (M,) speed to the left, m/s
    turn_rate: FloatArray  # (M,) rad/s
    ahead: FloatArray  # (M, horizons + 1) times of the future poses since the last one, seconds


def body_steps(poses: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Motion forward, to the left, and turn of each step (..., T-1) between `poses` (..., T, 3), in the body frame.

    A step of a turn points along its chord, so a circle at constant speed has constant steps.
    """
    turn = torch.remainder(poses[..., 1:, 2] - poses[..., :-1, 2] + torch.pi, 2 * torch.pi) - torch.pi
    middle = poses[..., :-1, 2] + turn / 2
    moved = poses[..., 1:, :2] - poses[..., :-1, :2]
    forward = moved[..., 0] * middle.cos() + moved[..., 1] * middle.sin()
    left = moved[..., 1] * middle.cos() - moved[..., 0] * middle.sin()
    return forward, left, turn


def drive_on(start: Tensor, forward: Tensor, left: Tensor, heading: Tensor, middle: Tensor) -> Tensor:
    """Poses (..., N, 3) after `start` (..., 3) by steps (..., N) in the body frame: undoes `body_steps`.

    Args:
        start: x, y and heading.
        forward: length of each step, or (..., 1) if all are alike.
        left: to the left, alike.
        heading: (..., N) after each step, radians.
        middle: (..., N) in the middle of each step.
    """
    x = forward * middle.cos() - left * middle.sin()
    y = forward * middle.sin() + left * middle.cos()
    return torch.stack([start[..., None, 0] + x.cumsum(-1), start[..., None, 1] + y.cumsum(-1), heading], dim=-1)


def extrapolate(poses: Tensor, steps: int) -> Tensor:
    """Poses (B, steps, 3) after `poses` (B, T, 3), x, y and heading, at constant turn rate and speed in the body frame.

    A single pose shown is taken to stand still.
    """
    if poses.shape[1] == 1:
        return poses.expand(poses.shape[0], steps, 3)
    forward, left, turn = body_steps(poses)
    rate = turn.mean(dim=1)[:, None]
    heading = poses[:, -1:, 2] + rate * torch.arange(1, steps + 1, dtype=poses.dtype, device=poses.device)
    mean_forward, mean_left = forward.mean(dim=1)[:, None], left.mean(dim=1)[:, None]
    return drive_on(poses[:, -1], mean_forward, mean_left, heading, heading - rate / 2)


def ego_futures(
    poses: FloatArray,
    times: FloatArray,
    horizons: int,
    count: int,
    generator: np.random.Generator,
    motion: EgoMotion,
    resolution: float,
) -> FloatArray:
    """Futures (count, horizons, 3) of the ego after `poses` (T, 3), equally likely; one alone is the likeliest.

    Every error is drawn stratified: each of the `count` equally likely parts of its distribution once, in an order of
    its own (a Latin hypercube), so that few futures stand for the rounding to whole cells too.

    Args:
        poses: x, y in cells, heading in radians, one a frame.
        times: (T,) of the frames, seconds; futures go on at their mean interval.
        horizons: frames ahead.
        count: futures.
        generator: source of randomness.
        motion: how the ego drives on.
        resolution: a cell's side in metres.
    """
    poses, times = np.asarray(poses, np.float64), np.asarray(times, np.float64)
    if len(poses) == 1:
        return np.tile(poses[0], (count, horizons, 1))
    if np.linalg.norm(poses[-1, :2] - poses[0, :2]) * resolution < motion.standing * (times[-1] - times[0]):
        return np.tile(poses[-1], (count, horizons, 1))
    seen = _seen(poses, times, horizons, motion, resolution)
    z = _stratified(count, 5, generator)
    pick = generator.permutation(np.searchsorted(np.cumsum(seen.likelihood), (np.arange(count) + 0.5) / count))
    return _driven(poses[-1], seen, np.minimum(pick, PHASES - 1), z, motion, resolution)


def cell_weights(futures: FloatArray, many: FloatArray) -> FloatArray:
    """Weights (K, N) of `futures` (K, N, 3), by which each cell counts as it does among `many` (M, any, 3).

    Few futures miss by chance how likely it is that the ego has come to the next cell, and all else lies a cell off
    then.  Post-stratification (Holt and Smith 1979) by the cell of each horizon mends that, as far as `many` reach and
    the futures visit cells that hold nearly all of their probability.
    """
    K, N, _ = futures.shape
    weights = np.full((K, N), 1 / K)
    for h in range(min(N, many.shape[1])):
        cells = np.concatenate([cells_of(futures[:, h]), cells_of(many[:, h])])
        cells -= cells.min(axis=0)
        place = cells[:, 0] * (cells[:, 1].max() + 1) + cells[:, 1]
        visits, chance = (np.bincount(at, minlength=place.max() + 1) for at in (place[:K], place[K:]))
        share = chance / len(many)
        if share[visits > 0].sum() >= VISITED:
            weights[:, h] = share[place[:K]] / visits[place[:K]]
            weights[:, h] /= weights[:, h].sum()
    return weights


def likeliest(
    poses: FloatArray, times: FloatArray, horizons: int, motion: EgoMotion, resolution: float
) -> tuple[FloatArray, FloatArray]:
    """The futures (M, horizons, 3) without error for each phase of the poses' clock, and their probabilities (M,).

    Args: as `ego_futures`; two poses at least.
    """
    seen = _seen(np.asarray(poses, np.float64), np.asarray(times, np.float64), horizons, motion, resolution)
    futures = _driven(poses[-1], seen, np.arange(PHASES), np.zeros((PHASES, 5)), motion, resolution)
    return futures, seen.likelihood


def _driven(
    start: FloatArray, seen: Seen, pick: NDArray[np.intp], z: FloatArray, motion: EgoMotion, resolution: float
) -> FloatArray:
    """Futures (K, horizons, 3) from `start` (3,) with phases `pick` (K,) and errors `z` (K, 5) in deviations."""
    speed, acceleration, since = seen.speed[pick], seen.acceleration[pick], seen.ahead[pick]
    z = z * motion.share(speed)[:, None]
    turn_rate = seen.turn_rate[pick] + z[:, 2] * motion.lateral / np.maximum(np.abs(speed), motion.full_speed)
    heading = start[2] + turn_rate[:, None] * since
    driving = speed != 0
    speed, acceleration = speed + z[:, 0] * motion.speed, acceleration + z[:, 1] * motion.acceleration
    # Who brakes, stops: the way does not go back once the speed has changed its sign.
    braking = (speed * acceleration < 0) & driving
    stop = np.where(braking, -speed / np.where(braking, acceleration, 1), np.inf)
    until = np.minimum(since, stop[:, None])
    way = speed[:, None] * until + acceleration[:, None] * until**2 / 2
    middle = (heading[:, 1:] + heading[:, :-1]) / 2
    forward, left = np.diff(way) / resolution, np.diff(seen.left[pick][:, None] * since) / resolution
    steps = (torch.from_numpy(v) for v in (forward, left, heading[:, 1:], middle))
    futures: FloatArray = drive_on(torch.from_numpy(start).expand(len(pick), 3), *steps).numpy()
    along, across = z[:, 3:4] * motion.position / resolution, z[:, 4:5] * motion.sideways / resolution
    cos, sin = np.cos(futures[..., 2]), np.sin(futures[..., 2])
    futures[..., 0] += along * cos - across * sin
    futures[..., 1] += along * sin + across * cos
    return futures


def planned(plan: FloatArray, horizons: int) -> FloatArray:
    """The one future (1, horizons, 3) that a `plan` (>=horizons, 3) in cells and radians gives.

    Raises:
        UserError: if the plan is shorter than the horizon, or holds no poses.
    """
    plan = np.asarray(plan, np.float64)
    if plan.ndim != 2 or plan.shape[1] != 3 or not np.isfinite(plan).all():
        raise UserError(f"a plan holds one pose a frame, x, y and heading, all finite: (N, 3), not {plan.shape}")
    if len(plan) < horizons:
        raise UserError(f"the plan has {len(plan)} poses, {horizons} frames are forecast; plan further or ask for less")
    return plan[None, :horizons]


def in_cells(poses: FloatArray, origin: FloatArray, resolution: float) -> FloatArray:
    """`poses` (..., 3) in metres and radians as poses in cells of the lattice whose cell (0, 0) lies at `origin`."""
    poses = np.asarray(poses, np.float64)
    return np.concatenate([(poses[..., :2] - origin) / resolution, poses[..., 2:]], axis=-1)


def cells_of(poses: FloatArray) -> NDArray[np.int64]:
    """The lattice cells (..., 2) that hold `poses` (..., 3) in cells and radians."""
    return np.floor(poses[..., :2] + 0.5).astype(np.int64)


def centre_offset(centre_cells: NDArray[np.integer], poses: FloatArray) -> NDArray[np.int64]:
    """Centre cells (T, 2) of grids less the cells that hold the ego at `poses` (T, 3): (2,) cells.

    It is 0, but for windows that are turned or cut out.
    """
    return np.asarray(np.median(centre_cells - cells_of(poses), axis=0), np.int64)


def _seen(poses: FloatArray, times: FloatArray, horizons: int, motion: EgoMotion, resolution: float) -> Seen:
    """Fit speed and acceleration to the steps between `poses`, given when each pose was taken."""
    forward, left, turn = (v.numpy() for v in body_steps(torch.from_numpy(poses)))
    forward, left = forward * resolution, left * resolution
    interval = (times[-1] - times[0]) / (len(times) - 1)
    frames = np.concatenate([times - times[-1], interval * np.arange(1, horizons + 1)])
    taken = np.tile(frames, (PHASES, 1))
    if motion.clock > 0:
        taken = np.floor(taken / motion.clock + (np.arange(PHASES) + 0.5)[:, None] / PHASES) * motion.clock
    steps = np.diff(taken[:, : len(poses)])
    if not (steps > 0).all():
        raise UserError(
            f"poses {interval:.3f} s apart cannot be fixes of a clock of {motion.clock} s; give a finer one"
        )
    centre = (taken[:, : len(poses) - 1] + taken[:, 1 : len(poses)]) / 2 - taken[:, len(poses) - 1 : len(poses)]
    # Least squares of forward = (speed + acceleration (centre - mean)) step, for each phase.
    mean = (centre * steps**2).sum(1, keepdims=True) / (steps**2).sum(1, keepdims=True)
    speed = (forward * steps).sum(1) / (steps**2).sum(1)
    slope = (centre - mean) * steps
    acceleration = np.zeros_like(speed)
    if len(forward) > 2:
        acceleration = (slope * forward).sum(1) / (slope**2).sum(1)
    residual = forward - speed[:, None] * steps - acceleration[:, None] * slope
    misfit = (residual**2).sum(1) / (2 * motion.noise**2)
    likelihood = np.exp(misfit.min() - misfit)
    lasting = motion.kept * np.clip(acceleration, -motion.largest, motion.largest)
    whole = steps.sum(1)
    return Seen(
        likelihood=likelihood / likelihood.sum(),
        speed=speed - lasting * mean[:, 0],
        acceleration=lasting,
        left=left.sum() / whole,
        turn_rate=turn.sum() / whole,
        ahead=taken[:, len(poses) - 1 :] - taken[:, len(poses) - 1 : len(poses)],
    )


def _stratified(count: int, variables: int, generator: np.random.Generator) -> FloatArray:
    """Standard normal draws (count, variables), each variable's one in every of `count` equally likely strata."""
    if count == 1:
        return np.zeros((1, variables))
    middle = ndtri((np.arange(count) + 0.5) / count)
    middle /= np.sqrt(np.mean(middle**2))  # the middles of few strata spread too little
    return np.stack([generator.permutation(middle) for _ in range(variables)], axis=1)
