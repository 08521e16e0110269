"""Motion within the sweep: whether scans are bent by the ego's own motion, and whether settings can straighten them."""

import numpy as np

from envpred.build.check_motion import Driven
from envpred.build.findings import Finding, Settings
from envpred.drives import Drive
from envpred.mapping.geometry import FloatArray
from envpred.mapping.sweep_motion import View, share_left_in
from envpred.mapping.trajectory import poses_at

APART = 6  # frames between two views
LEAST_MOTION = 0.3  # metres in one sweep, below which nothing is seen of it
LEFT_IN = 0.4  # share of it


def find_bends(seen: Driven, drive: Drive, settings: Settings) -> tuple[list[Finding], list[str]]:
    """Whether the ego's motion within its sweeps is left in the scans: a finding where settings mend it, else a note.

    Poses must be right, and z up.
    """
    motion = float(np.median(np.hypot(*seen.matched[seen.moving, :2].T)))
    if len(seen.points) <= APART or motion < LEAST_MOTION:
        return [], []
    path = seen.poses
    starts = range(0, len(seen.points) - APART, max(1, (len(seen.points) - APART) // 8))
    pairs = [
        (_view(seen, path, k), _view(seen, path, k + APART), _plane(np.linalg.inv(path[k]) @ path[k + APART]))
        for k in starts
    ]
    shares = {
        turn: share_left_in(pairs, drive.period, turn == "clockwise") for turn in ("clockwise", "counterclockwise")
    }
    turn = max(shares, key=lambda name: shares[name])
    if shares[turn] < LEFT_IN:
        return [], []
    how = f"{shares[turn]:.0%} of the {motion:.1f} m that the ego moves during a turn ({turn}) is left in the scans"
    if settings.folder is None:
        return [], [f"motion within the sweep: {how}; this layout says nothing that would take it out"]
    sweep = settings.folder.sweep(drive.frames[seen.first])
    timed = settings.folder.scans.time_column(sweep) is not None
    text = "deskew: {by: time}" if timed else f"deskew: {{by: azimuth, turn: {turn}}}"
    also = (
        ", with `unit` and `stamp` as your scanner has them" if timed else ", with `start` and `stamp` as it has them"
    )
    return [Finding("motion within the sweep", how, settings.write(text) + also)], []


def _view(seen: Driven, path: FloatArray, k: int) -> View:
    """Frame `k` from above, and how fast the sensor moves there."""
    around = slice(max(k - 1, 0), k + 2)
    now, soon = poses_at(np.array([0.0, 1.0]) + seen.times[k], seen.times[around], path[around])
    return View(seen.points[k], np.linalg.inv(now) @ soon)


def _plane(motion: FloatArray) -> FloatArray:
    return np.array([motion[0, 3], motion[1, 3], np.arctan2(motion[1, 0], motion[0, 0])])
