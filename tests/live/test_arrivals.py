"""What becomes of scans by their stamps and poses alone, worked out by hand: a period of 0.1 s."""

import numpy as np
from numpy.typing import NDArray

from envpred.live.arrivals import STEPS, Arrivals


def at(x: float) -> NDArray[np.float64]:
    """A pose so many metres east."""
    pose = np.eye(4)
    pose[0, 3] = x
    return pose


def test_a_jump_is_noticed_before_any_velocity_is_known() -> None:
    """From the first scan to the second, 9 m in 0.1 s are a fast car, 11 m none."""
    for x, kind in ((9.0, None), (11.0, "jump")):
        arrivals = Arrivals(0.1, bound=False)
        assert arrivals.judge(at(0), 0.0).kind is None
        assert arrivals.judge(at(x), 0.1).kind == kind


def test_a_pose_that_mirrors_or_stretches_is_none() -> None:
    arrivals = Arrivals(0.1, bound=False)
    for pose in (np.diag([1.0, -1, 1, 1]), np.diag([1.0, 2, 1, 1])):
        verdict = arrivals.judge(pose, 0.0)
        assert (verdict.taken, verdict.kind) == (False, "pose")
    assert arrivals.judge(np.diag([-1.0, -1, 1, 1]), 0.0).taken  # to the west


def test_another_rate_is_told_by_steps_since_the_clock_was_set_back() -> None:
    """Five steps of 0.2 s before it are of another recording: it takes eight after it, not three."""
    arrivals = Arrivals(0.1, bound=False)
    for n in range(6):
        assert arrivals.judge(at(0), 0.2 * n).period is None
    assert arrivals.judge(at(0), -99.0).kind == "set back"
    kinds = [arrivals.judge(at(0), -99 + 0.2 * n).kind for n in range(1, STEPS + 1)]
    assert kinds == ["gap"] * (STEPS - 1) + ["rate"]
