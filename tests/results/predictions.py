"""A folder of predictions written by hand, and the store it was forecast from."""

import json
import zlib
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from envpred.results.predictions import FORMAT, Predictions
from envpred.store import Store

DRIVE = {"lattice_origin_m": [0.0, 0.0], "resolution_m": 0.2, "cells": 8, "evidence_checksum": 5}


def folder_of(folder: Path, forecast: NDArray[np.float32], **facts: Any) -> Predictions:
    """One window of drive a: frames 3 and 4 shown, then 20 Hz into the future."""
    (folder / "a").mkdir(parents=True)
    np.save(folder / "a" / "4.npy", forecast)
    window = {"drive": "a", "start": 3, "frames": [3, 4], "targets": 2, "file": "a/4.npy"}
    manifest = {
        "format": FORMAT,
        "model": {"name": "mine"},
        "role": "learned",
        "variant": "dst_static",
        "data": {"context": None},
        "horizon_s": [0.05, 0.1, 0.15],
        "drives": {"a": DRIVE},
        "windows": [window | {"checksum": zlib.crc32(forecast.tobytes())}],
    }
    (folder / "manifest.json").write_text(json.dumps(manifest | facts))
    return Predictions(folder)


def store_of(arrays: dict[str, NDArray[Any]]) -> Store:
    """A store of that drive that holds such `arrays`."""
    lattice = {"origin": [0.0, 0.0], "resolution": 0.2, "cells": 8}
    manifest = {"lattice": lattice, "arrays": {"evidence": {"checksum": 5}}}
    drive = SimpleNamespace(manifest=manifest, array=lambda name: arrays[name], frames=list(range(7)))
    return cast(Store, SimpleNamespace(folder=Path("grids"), drives={"a": drive}))


FORECAST = np.full((3, 8, 8), 0.25, np.float32)
