"""What becomes of a scan that arrives: taken, left out, or the first of a new start, as its stamp and pose say.

A stream goes by the rule of the stores: a step that differs from the period by more than half of it is a gap, after
which evidence starts anew.
"""

from collections import deque
from typing import NamedTuple

import numpy as np

from envpred.drives.plausible import FASTEST, ROUND
from envpred.mapping.geometry import FloatArray, heading_of
from envpred.mapping.period import STRAY, is_gap, nominal

LEAP = 20.0  # m/s by which a car's velocity cannot change from one scan to the next: its pose has jumped
SPIN = 2 * np.pi  # rad/s that no car turns by
SET_BACK = 2.0  # seconds: a scan that is older by more is not late, its clock was set back
STEPS = 8  # between scans that must agree before the rate counts as another
ALIKE = 0.25  # share of their median by which such steps may differ
OTHER = 0.1  # share by which another rate differs at least


class Verdict(NamedTuple):
    """What becomes of a scan.

    Args:
        taken: whether it is mapped.
        anew: whether all that was seen before it is forgotten.
        elsewhere: whether its pose has nothing to do with those before it.
        kind: of what there is to be said, None for nothing.
        said: about it, one line.
        period: seconds between scans from here on, where that has changed.
    """

    taken: bool
    anew: bool = False
    elsewhere: bool = False
    kind: str | None = None
    said: str = ""
    period: float | None = None


class Arrivals:
    """Judges scans one after the other.

    Args:
        period: seconds between the scans that are mapped.
        bound: whether that must stay so, as weights were trained at it: faster scans are thinned then, and slower ones
            not taken.
    """

    def __init__(self, period: float, bound: bool) -> None:
        self.period, self.bound = period, bound
        self._rate, self._every = period, 1  # seconds between scans that arrive, and which of them are taken
        self._arrived: float | None = None
        self._steps: deque[float] = deque(maxlen=STEPS)
        self._taken: tuple[float, FloatArray] | None = None  # time and pose of the last scan that was mapped
        self._velocity: FloatArray | None = None

    def judge(self, pose: FloatArray | None, time: float) -> Verdict:
        """What becomes of a scan with this `pose` (4, 4) and `time` (seconds)."""
        if not np.isfinite(time):
            return Verdict(False, kind="stamp", said=f"a scan without a time ({time}): left out")
        if pose is None or not _is_rigid(pose):
            return Verdict(False, kind="pose", said=f"the scan at {time:.2f} s has no pose: left out")
        verdict = self._in_order(time) or self._another_rate(time) or self._follows(pose, time)
        if verdict.taken:
            before = None if verdict.anew else self._taken
            self._velocity = None if before is None else (pose[:2, 3] - before[1][:2, 3]) / (time - before[0])
            self._taken = time, pose
        return verdict

    def _in_order(self, time: float) -> Verdict | None:
        """The verdict on a scan that is not newer than the one before; None for one that is."""
        step = np.inf if self._arrived is None else time - self._arrived
        if step > 0:
            return None
        if step < -SET_BACK:
            self._arrived = time
            self._steps.clear()
            said = f"the clock was set back by {-step:.2f} s to {time:.2f} s: evidence starts anew"
            return Verdict(True, anew=True, elsewhere=True, kind="set back", said=said)
        kind = "late" if step < 0 else "repeated"
        what = f"{-step:.3f} s older than" if step < 0 else "of the same time as"
        return Verdict(False, kind=kind, said=f"the scan at {time:.2f} s is {what} the one before: left out")

    def _another_rate(self, time: float) -> Verdict | None:
        """The verdict on the scan by which another rate is noticed; None as long as it is what it was."""
        if self._arrived is not None:
            self._steps.append(time - self._arrived)
        self._arrived = time
        steps = np.array(self._steps)
        if len(steps) < STEPS or np.ptp(steps) > ALIKE * np.median(steps):
            return None
        rate = nominal(steps)
        if abs(rate - self._rate) <= OTHER * self._rate:
            return None
        was, self._rate = self._rate, rate
        changed = f"scans come every {rate:.3g} s instead of {was:.3g} s at {time:.2f} s"
        if not self.bound:
            self.period = rate
            return Verdict(True, True, kind="rate", said=f"{changed}: evidence starts anew", period=rate)
        every = round(self.period / rate)
        self._every = every if every and abs(every * rate - self.period) <= OTHER * self.period else 0
        if not self._every:
            said = f"{changed}, and the weights were trained on {self.period:.3g} s: no forecasts meanwhile"
            return Verdict(False, kind="rate", said=said)
        which = "every one is taken" if self._every == 1 else f"one of {self._every} is taken"
        return Verdict(True, True, kind="rate", said=f"{changed}: {which}, and evidence starts anew")

    def _follows(self, pose: FloatArray, time: float) -> Verdict:
        """The verdict on a scan that is newer than the one before, at the rate that is known."""
        if not self._every or self._taken is None:
            return Verdict(bool(self._every))
        before, last = self._taken
        step = time - before
        if self._every > 1 and step < self.period * (1 - STRAY / self._every):
            return Verdict(False)
        if is_gap(step, self.period):
            if step < self.period:
                said = f"the scan at {time:.2f} s comes {step:.3f} s after the one before, not {self.period:.3g} s"
                return Verdict(False, kind="early", said=f"{said}: left out")
            said = f"no scan for {step:.2f} s before {time:.2f} s: evidence starts anew"
            return Verdict(True, anew=True, kind="gap", said=said)
        velocity = (pose[:2, 3] - last[:2, 3]) / step
        turn = abs((heading_of(pose) - heading_of(last) + np.pi) % (2 * np.pi) - np.pi)
        change = 0.0 if self._velocity is None else float(np.linalg.norm(velocity - self._velocity))
        if np.linalg.norm(velocity) > FASTEST or change > LEAP or turn > SPIN * step:
            moved = float(np.linalg.norm(velocity)) * step
            said = f"the pose at {time:.2f} s has jumped, by {moved:.2f} m and {np.degrees(turn):.0f} degrees"
            return Verdict(True, True, True, kind="jump", said=f"{said}: evidence starts anew")
        return Verdict(True)


def _is_rigid(pose: FloatArray) -> bool:
    """Whether a pose moves things without bending them."""
    if np.shape(pose) != (4, 4) or not np.isfinite(pose).all():
        return False
    rotation = pose[:3, :3]
    return bool(np.abs(rotation @ rotation.T - np.eye(3)).max() <= ROUND and np.linalg.det(rotation) > 0)
