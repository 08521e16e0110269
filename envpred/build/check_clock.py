"""Clocks of poses and scans: the offset at which both say the same of the ego's motion."""

import numpy as np
from numpy.typing import NDArray

from envpred.build.check_motion import Driven, Fit, is_usual, scans_and_poses, spins
from envpred.build.findings import Finding, Settings
from envpred.mapping.geometry import FloatArray
from envpred.mapping.trajectory import motions, poses_at

OFFSETS = np.arange(-0.6, 0.601, 0.02)  # seconds by which clocks are tried apart
LEAST_OFFSET = 0.07  # seconds; less may be the moment of a sweep that a scan is stamped with
LEVER = 10.0  # metres at which a turn counts as much as a shift
SMOOTH = 5  # steps over which both are averaged, as stamps may beat
KEPT = 0.8  # share of the steps that fit best
BETTER = 0.4  # of what was left without an offset
APART = 0.06  # seconds by which the halves of a drive may differ


def find_clock(seen: Driven, settings: Settings) -> list[Finding]:
    """Whether poses fit the scans better at other times than those that they are said to be of."""
    of_scans, fit = scans_and_poses(seen)
    to_car = of_scans @ seen.level.T
    if is_usual(fit.scale):  # by how much it differs from 1 may come from the clock
        fit = fit._replace(scale=1.0)
    times, poses = seen.path
    poses = np.asarray(np.linalg.inv(poses) if fit.inverse else poses, np.float64)
    inside = (seen.times + OFFSETS[0] >= times[0]) & (seen.times + OFFSETS[-1] <= times[-1])
    use = np.flatnonzero(inside[:-1] & inside[1:])
    if len(use) < 3 * SMOOTH:
        return []
    left = np.stack([_misses(seen, use, poses_at(seen.times + d, times, poses), fit, to_car) for d in OFFSETS])
    half = left.shape[1] // 2
    best, *halves = (_best(part) for part in (left, left[:, :half], left[:, half:]))
    now = _cost(left)[int(np.argmin(np.abs(OFFSETS)))]
    if abs(best) < LEAST_OFFSET or _cost(left).min() > BETTER * now or max(abs(h - best) for h in halves) > APART:
        return []
    clock = settings.folder.track.said.clock if settings.folder else 0.0
    how = f"poses fit scans best {abs(best):.2f} s {'later' if best > 0 else 'earlier'} than they are stamped"
    return [Finding("clock offset", how, settings.write(f"poses: {{clock: {clock - best:.2f}}}"))]


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


def _best(left: FloatArray) -> float:
    return float(OFFSETS[int(np.argmin(_cost(left)))])
