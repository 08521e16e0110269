"""The time between frames: what a recording's stamps say, what is a gap, and what numbers per frame become.

The paper's numbers hold for frames of 0.1 s.
"""

import numpy as np

from envpred.mapping.geometry import FloatArray

PERIOD = 0.1  # seconds between the paper's frames
SNAP = 0.05  # share by which a period may miss a whole number of Hz and still be it: KITTI's scanner turns at 9.66 Hz
STRAY = 0.5  # share by which a step may differ from the period and still be one


def nominal(steps: FloatArray) -> float:
    """The period in seconds of frames whose stamps lie `steps` (N,) seconds apart: their median, or that of whole Hz.

    Without any step (a single frame) it is the paper's.
    """
    if not len(steps):
        return PERIOD
    median = float(np.median(steps))
    hertz = max(round(1 / median), 1)
    return 1 / hertz if abs(median * hertz - 1) <= SNAP else median


def is_gap(step: float, period: float) -> bool:
    """Whether two frames `step` seconds apart do not follow each other at `period` seconds."""
    return abs(step - period) > STRAY * period
