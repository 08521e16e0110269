"""A small drive with a gap, and what else tests of replays share."""

import base64
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from envpred.drives import Drive, one_drive
from envpred.mapping.geometry import GridSpec
from tests.drives.synthetic import write_drive

GRID = GridSpec(64)
GAP = 18  # a frame without a scan
FRAMES = 30


def small_drive(folder: Path) -> Drive:
    """A drive of 29 scans, five of which are seen before the first forecast and after the gap."""
    write_drive(folder, frames=FRAMES, weave=0.3, azimuths=180, missing_scans={GAP})
    return one_drive(folder)


def forecast_frames() -> list[int]:
    """Positions of the scans after which there is a forecast."""
    return [*range(4, GAP), *range(GAP + 4, FRAMES - 1)]


def unpacked(text: str) -> NDArray[np.uint8]:
    """What a page holds, by Python's own means."""
    return np.frombuffer(zlib.decompress(base64.b64decode(text)), np.uint8)
