"""Clocks of poses and scans: the offset at which both say the same of the ego's motion."""

import numpy as np
from numpy.typing import NDArray

from envpred.build.check_motion import Driven, Fit, may_be_clock, scans_and_poses, spins
from envpred.build.findings import Finding, Settings
from envpred.mapping.geometry import FloatArray
from envpred.mapping.trajectory import motions, poses_at

OFFSETS = np.arange(-0.7, 0.701, 0.02)  # seconds by which clocks are tried apart
LEAST_OFFSET = 0.07  # seconds; less may be the moment of a sweep that a scan is stamped with
LEVER = 10.0  # metres at which a turn counts as much as a shift
SMOOTH = 5  # steps over which both are averaged, as stamps may beat
KEPT = 0.8  # share of the steps that fit best
TELLS = 1 / 0.3  # times what is left at the best offset that must be left at the worst
BETTER = 0.3  # of what was left without an offset
WORSE = 1.2  # times what was left without it, for either half of a drive
LEAST_STEP = 0.3  # metres: shorter ones are matched too short, as a scanner's pattern of beams goes along with it


def find_clock(seen: Driven, settings: Settings) -> tuple[list[Finding], list[str]]:
    """Whether poses fit the scans better at other times than those they are said to be of; a note if nothing tells."""
    of_scans, fit = scans_and_poses(seen)
    to_car = of_scans @ seen.level.T
    if may_be_clock(fit.scale):
        fit = fit._replace(scale=1.0)
    times, poses = seen.path
    poses = np.asarray(np.linalg.inv(poses) if fit.inverse else poses, np.float64)
    inside = (seen.times + OFFSETS[0] >= times[0]) & (seen.times + OFFSETS[-1] <= times[-1])
    long = np.hypot(seen.matched[:, 0], seen.matched[:, 1]) >= LEAST_STEP
    use = np.flatnonzero(inside[:-1] & inside[1:] & long)
    if len(use) < 3 * SMOOTH:
        return [], ["the ego is slow, or the drive short: clocks of poses and scans were not compared"]
    left = np.stack([_misses(seen, use, poses_at(seen.times + d, times, poses), fit, to_car) for d in OFFSETS])
    costs, now = _cost(left), int(np.argmin(np.abs(OFFSETS)))
    if costs.max() < TELLS * costs.min():
        return [], ["the ego's speed and heading hardly change: clocks of poses and scans were not compared"]
    found = int(np.argmin(costs))
    best = float(OFFSETS[found])
    if found in (0, len(OFFSETS) - 1):  # no minimum
        return [], []
    half = left.shape[1] // 2
    halves = [_cost(part) for part in (left[:, :half], left[:, half:])]  # one at constant speed says nothing
    if abs(best) < LEAST_OFFSET or costs[found] > BETTER * costs[now]:
        return [], []
    if any(cost[found] > WORSE * cost[now] for cost in halves):
        return [], []
    clock = settings.folder.track.said.clock if settings.folder else 0.0
    how = f"poses fit scans best {abs(best):.2f} s {'later' if best > 0 else 'earlier'} than they are stamped"
    return [Finding("clock offset", how, settings.write(f"poses: {{clock: {clock - best:.2f}}}"))], []


def _misses(seen: Driven, use: NDArray[np.intp], poses: FloatArray, fit: Fit, to_car: FloatArray) -> FloatArray:
    """What poses miss of the matched steps (m, 3), in metres, averaged over some."""
    posed = motions(poses)
    shift = fit.scale * posed[:, :3, 3] @ fit.turned.T
    said = np.column_stack([shift[:, :2], LEVER * (spins(posed) @ fit.turned.T)[:, 2]])
    matched = np.column_stack([seen.matched[:, :2] @ to_car[:2, :2].T, LEVER * seen.matched[:, 2]])
    miss = (said - matched)[use]
    summed = np.cumsum(np.concatenate([np.zeros((1, 3)), miss]), axis=0)
    averaged: FloatArray = (summed[SMOOTH:] - summed[:-SMOOTH]) / SMOOTH
    return averaged


def _cost(left: FloatArray) -> FloatArray:
    """Mean square (offsets,) of the best part of misses (offsets, m, 3)."""
    square = np.sort((left**2).sum(axis=2), axis=1)
    cost: FloatArray = square[:, : max(int(KEPT * square.shape[1]), 1)].mean(axis=1)
    return cost
