"""Where the ego will be: futures from the poses shown, with a spread that is estimated on drives, or from a plan.

A pose is x and y in cells of the drive's lattice and the heading in radians; a future is one pose a frame.
"""

from dataclasses import dataclass

import numpy as np
import torch
from scipy.special import ndtri
from torch import Tensor

from envpred.errors import UserError
from envpred.mapping.geometry import FloatArray


@dataclass(frozen=True)
class EgoMotion:
    """How the ego is taken to drive on: at constant turn rate and acceleration, with errors that grow with its speed.

    Below `full_speed` all deviations shrink with the speed: who stands, stands.

    Args:
        position: standard deviation of where the ego is found at a future frame, metres along the way.
        sideways: the same across the way.
        speed: standard deviation of the present speed, m/s.
        acceleration: standard deviation of the acceleration, m/s^2.
        turn_rate: standard deviation of the turn rate, rad/s.
        kept: share of the acceleration seen over the frames shown that is taken to last.
        full_speed: speed in m/s from which on the deviations are whole.
        largest: acceleration in m/s^2 beyond which what is seen counts as noise of the poses.
    """

    position: float = 0.04
    sideways: float = 0.02
    speed: float = 0.15
    acceleration: float = 0.8
    turn_rate: float = 0.03
    kept: float = 0.5
    full_speed: float = 2.0
    largest: float = 3.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value >= 0 or (name == "full_speed" and value == 0):
                raise UserError(
                    f"{name} of the ego's motion must {'not be negative' if value else 'exceed 0'}: {value}"
                )

    def share(self, speed: float) -> float:
        """The share of the deviations that an ego of `speed` in m/s has, 0 to 1."""
        return min(abs(speed) / self.full_speed, 1.0)


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


def drive_on(start: Tensor, forward: Tensor, left: Tensor, rate: Tensor, steps: int) -> Tensor:
    """Poses (..., steps, 3) after `start` (..., 3) at a constant turn `rate` (...,) a step: undoes `body_steps`.

    `forward` and `left` are (..., steps), or (..., 1) if all steps are alike.
    """
    k = torch.arange(1, steps + 1, dtype=start.dtype, device=start.device)
    heading = start[..., None, 2] + rate[..., None] * k
    middle = heading - rate[..., None] / 2
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
    mean_forward, mean_left = forward.mean(dim=1)[:, None], left.mean(dim=1)[:, None]
    return drive_on(poses[:, -1], mean_forward, mean_left, turn.mean(dim=1), steps)


def ego_futures(
    poses: FloatArray,
    horizons: int,
    count: int,
    generator: np.random.Generator,
    motion: EgoMotion,
    resolution: float,
    period: float,
) -> FloatArray:
    """Futures (count, horizons, 3) of the ego after `poses` (T, 3); one alone is the likeliest.

    Every error is drawn stratified: each of the `count` equally likely parts of its distribution once, in an order of
    its own (a Latin hypercube), so that few futures stand for the rounding to whole cells too.

    Args:
        poses: x, y in cells, heading in radians, one a frame.
        horizons: frames ahead.
        count: futures.
        generator: source of randomness.
        motion: how the ego drives on.
        resolution: a cell's side in metres.
        period: seconds between frames.
    """
    shown = torch.from_numpy(np.asarray(poses, np.float64))
    speed, acceleration, left, rate = _motion_shown(shown, motion, resolution, period)
    z = _stratified(count, 5, generator) * motion.share(speed)
    speeds = speed + z[:, 0] * motion.speed
    accelerations = acceleration + z[:, 1] * motion.acceleration
    rates = rate + z[:, 2] * motion.turn_rate
    middle = (np.arange(horizons) + 0.5) * period
    forward = speeds[:, None] + accelerations[:, None] * middle
    if speed > 0:  # who brakes, stops
        forward = np.maximum(forward, 0)
    cells = period / resolution
    start = shown[-1].expand(count, 3)
    steps = torch.from_numpy(forward * cells), torch.full((count, 1), left * cells, dtype=torch.float64)
    futures: FloatArray = drive_on(start, *steps, torch.from_numpy(rates * period), horizons).numpy()
    along = z[:, 3:5] * (motion.position, motion.sideways) / resolution
    cos, sin = np.cos(futures[..., 2]), np.sin(futures[..., 2])
    futures[..., 0] += along[:, :1] * cos - along[:, 1:] * sin
    futures[..., 1] += along[:, :1] * sin + along[:, 1:] * cos
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


def _motion_shown(
    shown: Tensor, motion: EgoMotion, resolution: float, period: float
) -> tuple[float, float, float, float]:
    """Present speed, acceleration, speed to the left and turn rate, in metres and seconds, over poses (T, 3)."""
    if len(shown) == 1:
        return 0.0, 0.0, 0.0, 0.0
    forward, left, turn = (v.numpy() for v in body_steps(shown))
    mean = float(forward.mean()) * resolution / period
    seen = 0.0
    if len(forward) > 2:
        frames = np.arange(len(forward)) - (len(forward) - 1) / 2
        seen = float(frames @ forward / (frames @ frames)) * resolution / period**2
    acceleration = motion.kept * min(max(seen, -motion.largest), motion.largest)
    # The mean speed is that of the middle of the frames shown.
    present = mean + acceleration * period * len(forward) / 2
    return present, acceleration, float(left.mean()) * resolution / period, float(turn.mean()) / period


def _stratified(count: int, variables: int, generator: np.random.Generator) -> FloatArray:
    """Standard normal draws (count, variables), each variable's one in every of `count` equally likely strata."""
    if count == 1:
        return np.zeros((1, variables))
    middle = ndtri((np.arange(count) + 0.5) / count)
    middle /= np.sqrt(np.mean(middle**2))  # the middles of few strata spread too little
    return np.stack([generator.permutation(middle) for _ in range(variables)], axis=1)
