"""The smallest store there is, of one drive of five frames with a gap, for tests of reading and writing."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envpred.store import DriveWriter, Store

PARAMETERS = {"grid": {"cells": 8, "resolution": 1 / 3}, "sensor": "calibration"}
FRAMES = 5
ABOUT = {
    "frames": [3, 4, 5, 8, 9],
    "stretches": [(0, 3), (3, 2)],
    "lattice": {"origin": [1.5, -2.0], "resolution": 1 / 3, "cells": 8, "context": 16},
    "period": 0.05,
    "sensor": np.diag([1.0, 1, 1, 1]).tolist(),
    "body": {"rear": -1.0, "front": 2.0, "half_width": 0.9},
}
VELOCITY = np.ones((FRAMES, 2, 8, 8), np.float16)


def label(seed: int = 0) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 4, (FRAMES, 8, 8)).astype(np.uint8)


def write(
    store: Path,
    drive: str = "a",
    group: str = "mapping",
    key: str | None = None,
    arrays: dict[str, NDArray[Any]] | None = None,
) -> Path:
    key = key or Store(store).claim(group, PARAMETERS)
    with DriveWriter(store, drive, group, key, ABOUT | {"drive": drive}) as out:
        for name, values in (arrays or {"label": label(), "time": np.arange(5.0)}).items():
            out.add(name, values.dtype, values.shape).extend(values)
    return store / drive
