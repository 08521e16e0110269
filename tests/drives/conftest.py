"""A few frames of a street as a folder with an `envpred.yaml`."""

from pathlib import Path

import numpy as np
import pytest

from tests.drives import own, synthetic

FRAMES = 8


@pytest.fixture(scope="module")
def recorded() -> own.Recorded:
    """A few frames of a street, weaving."""
    body = synthetic.motion(FRAMES, speed=5.0, weave=0.3)
    scans = list(synthetic.scans(body, 0.0, 90))
    since = [np.linspace(0, 0.09, len(points)) for points in scans]
    return own.Recorded(scans, since, body, np.asarray(100 + own.PERIOD * np.arange(FRAMES), np.float64))


@pytest.fixture
def folder(recorded: own.Recorded, tmp_path: Path) -> Path:
    return own.write(tmp_path / "mine", recorded)
