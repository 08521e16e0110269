"""How well the ego's future is known: the spread of its motion estimated on drives, and whether futures keep to it."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls

from envpred.errors import UserError
from envpred.mapping.ego_motion import EgoMotion, ego_futures, likeliest
from envpred.mapping.geometry import FloatArray


class Track(NamedTuple):
    """The ego's way through one drive, without a gap."""

    poses: FloatArray  # (T, 3) x, y in cells, heading in radians
    times: FloatArray  # (T,) seconds


def estimate(
    tracks: Sequence[Track], resolution: float, given: int = 5, horizons: int = 15, motion: EgoMotion | None = None
) -> EgoMotion:
    """The spread that the errors of the likeliest future have on `tracks`; every track counts alike.

    The squared errors along the way at time t are fitted by position^2 + (speed t)^2 + (acceleration t^2 / 2)^2, for
    that share of the acceleration seen which makes the errors smallest.

    Args:
        tracks: ways of the ego; parts of it that are slower than `full_speed` take no part.
        resolution: a cell's side in metres.
        given: frames shown.
        horizons: frames ahead.
        motion: what is not estimated: `full_speed`, `largest`, `clock`, `noise`.

    Raises:
        UserError: if no part of the tracks is long and fast enough.
    """
    motion = motion or EgoMotion()
    best: tuple[float, EgoMotion] | None = None
    for kept in np.linspace(0, 1, 11).tolist():
        trial = replace(motion, kept=kept)
        along, across, turned, t = _squared_errors(tracks, trial, resolution, given, horizons)
        misfit = float(np.mean(np.log(along)))
        if best is None or misfit < best[0]:
            parts = np.stack([np.ones_like(t), t**2, t**4 / 4], axis=1)
            position, speed, acceleration = np.sqrt(nnls(parts / along[:, None], np.ones_like(along))[0]).tolist()
            lateral = float(np.sqrt(np.mean(turned / t**2)))
            sideways = float(np.sqrt(max(across[0] - (lateral * t[0] ** 2 / 2) ** 2, 0.0)))
            spread = replace(
                trial, position=position, speed=speed, acceleration=acceleration, lateral=lateral, sideways=sideways
            )
            best = misfit, spread
    assert best is not None
    return best[1]


def coverage(
    tracks: Sequence[Track],
    motion: EgoMotion,
    resolution: float,
    levels: Sequence[float] = (0.5, 0.8, 0.95),
    given: int = 5,
    horizons: int = 15,
    count: int = 64,
) -> FloatArray:
    """Share (levels, horizons, 3) of true futures inside the central intervals of `count` sampled ones.

    The last axis: position along the way, across it, and heading.  A spread is calibrated where the shares are the
    levels.

    Args:
        tracks, resolution, given, horizons: as `estimate`.
        motion: the spread to look at.
        levels: probabilities of the central intervals.
        count: futures sampled.
    """
    levels_ = np.asarray(levels)
    inside = []
    for track in tracks:
        for shown, times, true in _windows(track, given, horizons):
            futures = ego_futures(shown, times, horizons, count, np.random.default_rng(0), motion, resolution)
            off = _in_body_frame(futures, true, resolution)  # of the sampled ones, seen from the true one
            below = np.quantile(off, (1 - levels_) / 2, axis=0)
            above = np.quantile(off, (1 + levels_) / 2, axis=0)
            inside.append((below <= 0) & (above >= 0))
    if not inside:
        raise UserError(f"no drive has {given + horizons} frames without a gap; give longer ones")
    shares: FloatArray = np.mean(inside, axis=0)
    return shares


def _squared_errors(
    tracks: Sequence[Track], motion: EgoMotion, resolution: float, given: int, horizons: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Mean squared errors (horizons,) along (m^2) and across (m^2), of the turn times speed (m^2/s^2), and the times.

    Which phase of the poses' clock was the true one is found by expectation and maximisation.
    """
    errors, likelihoods, intervals = [], [], []
    for track in tracks:
        own = []
        for shown, times, true in _windows(track, given, horizons):
            speed = np.linalg.norm(shown[-1, :2] - shown[0, :2]) * resolution / (times[-1] - times[0])
            if speed >= motion.full_speed:
                futures, likelihood = likeliest(shown, times, horizons, motion, resolution)
                own.append((_in_body_frame(futures, true, resolution) * (1, 1, speed)) ** 2)
                likelihoods.append(likelihood)
        if own:
            errors.append(np.array(own))
            intervals.append(float(np.mean(np.diff(track.times))))
    if not errors:
        raise UserError(
            f"no drive has {given + horizons} frames faster than {motion.full_speed} m/s; give drives that move"
        )
    weights = np.concatenate([np.full(len(own), 1 / len(own) / len(errors)) for own in errors])
    squared, likelihood = (
        np.concatenate(errors),
        np.array(likelihoods),
    )  # (windows, phases, horizons, 3), (windows, phases)
    true_phase = likelihood
    for _ in range(20):
        along = np.maximum(np.einsum("w,wp,wph->h", weights, true_phase, squared[..., 0]), 1e-8)
        # Errors of neighbouring horizons go together; the first one tells phases apart.
        fit = np.log(np.maximum(likelihood, 1e-300)) - squared[..., 0, 0] / (2 * along[0])
        true_phase = np.exp(fit - fit.max(axis=1, keepdims=True))
        true_phase /= true_phase.sum(axis=1, keepdims=True)
    across, turned = np.einsum("w,wp,wphc->ch", weights, true_phase, squared[..., 1:])
    return along, across, turned, np.mean(intervals) * np.arange(1, horizons + 1)


def _windows(track: Track, given: int, horizons: int) -> Iterator[tuple[FloatArray, FloatArray, FloatArray]]:
    for start in range(len(track.poses) - given - horizons + 1):
        now = start + given
        yield track.poses[start:now], track.times[start:now], track.poses[now : now + horizons]


def _in_body_frame(poses: FloatArray, true: FloatArray, resolution: float) -> FloatArray:
    """`poses` (..., N, 3) from the `true` ones (N, 3): metres forward and to the left of them, radians."""
    off = poses - true
    cos, sin = np.cos(true[:, 2]), np.sin(true[:, 2])
    turned = (off[..., 2] + np.pi) % (2 * np.pi) - np.pi
    east, north = off[..., 0] * resolution, off[..., 1] * resolution
    return np.stack([cos * east + sin * north, cos * north - sin * east, turned], axis=-1)
