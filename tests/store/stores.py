"""A tiny store of grids, written without any drive, for tests of what reads stores."""

import itertools
from collections.abc import Collection
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envpred.mapping import evidence
from envpred.mapping.boxes import MOVES, NO_BOX
from envpred.mapping.evidence import pignistic
from envpred.mapping.geometry import EGO, FREE, OCCUPIED, PAPER_SENSOR_OFFSET, Body
from envpred.store import DriveWriter, Store


def write_store(
    folder: Path,
    drives: dict[str, list[int]],
    cells: int = 16,
    parameters: dict[str, Any] | None = None,
    seed: int = 0,
    dogma: bool = False,
    context: int | None = None,
    period: float = 0.1,
    frame: str = "ego",
    moving: Collection[str] = (),
) -> Path:
    """A store whose `drives` have the given frame numbers: a box moves through free space, the ego drives east.

    Args:
        folder: of the store.
        drives: name -> frame numbers.
        cells: of the judged grid.
        parameters: that the mapping is said to have been made with.
        seed: of the box.
        dogma: whether velocities and particle forecasts are there too.
        context: cells of the wide grid, whose outer cells are free but for a wall at its eastern border.
        period: seconds between frames.
        frame: that velocities are said to be relative to.
        moving: names of the drives that say where the box is, one that moves.
    """
    random = np.random.default_rng(seed)
    key = Store(folder).claim("mapping", parameters or {"cells": cells, "evidence": asdict(evidence.PAPER)})
    wide_key = Store(folder).claim("context", {"cells": context}) if context else ""
    for name, frames in drives.items():
        T = len(frames)
        labels = np.full((T, cells, cells), FREE, np.uint8)
        row, speed = int(random.integers(1, cells // 2 - 2)), int(random.integers(1, 3))
        for t in range(T):
            column = (t * speed) % (cells - 2)
            labels[t, column : column + 2, row : row + 2] = OCCUPIED
            labels[t, cells // 2, cells // 2] = EGO
        labels[:, :, -2:] = 0
        centre_cell = np.stack([np.arange(T) // 3 + 40, np.full(T, 40)], axis=1).astype(np.int32)
        pose = np.tile(np.eye(4), (T, 1, 1))
        pose[:, 0, 3] = np.arange(T) / 9 + 40 / 3
        pose[:, 1, 3] = 40 / 3
        breaks = [0, *(np.flatnonzero(np.diff(frames) != 1) + 1).tolist(), T]
        about: dict[str, Any] = {
            "drive": name,
            "frames": frames,
            "stretches": [(a, b - a) for a, b in itertools.pairwise(breaks)],
            "source": {"drive": name, "frames": T},
            "lattice": {"origin": [0.0, 0.0], "resolution": 1 / 3, "cells": cells, "context": None},
            "period": period,
            "sensor": PAPER_SENSOR_OFFSET.tolist(),
            "body": asdict(Body()),
        }
        mass = evidence.accumulate(labels, centre_cell).astype(np.float16)
        arrays: dict[str, NDArray[Any]] = {
            "label": labels,
            "evidence": mass,
            "centre_cell": centre_cell,
            "pose": pose,
            "time": period * np.arange(T),
        }
        velocity = np.zeros((T, 2, cells, cells), np.float16)
        velocity[:, 0][labels == OCCUPIED] = speed / 3 / period  # m/s
        covariance = np.zeros((T, 3, cells, cells), np.float16)
        covariance[:, [0, 2]] = 0.25
        ahead = np.repeat((255 * pignistic(mass)).astype(np.uint8)[:, None], 15, axis=1)
        dynamic: dict[str, NDArray[Any]] = {
            "velocity": velocity,
            "velocity_cov": covariance,
            "particle_forecast": ahead,
        }
        with DriveWriter(folder, name, "mapping", key, about) as out:
            for array, values in arrays.items():
                out.add(array, values.dtype, values.shape).extend(values)
        if context:
            rim = (context - cells) // 2
            wide = np.pad(labels, ((0, 0), (rim, rim), (rim, rim)), constant_values=FREE)
            wide[:, -1] = OCCUPIED
            wide_mass = evidence.accumulate(wide, centre_cell).astype(np.float16)
            lattice = {"lattice": {**about["lattice"], "context": context}}
            with DriveWriter(folder, name, "context", wide_key, lattice) as out:
                out.add("context_label", wide.dtype, wide.shape).extend(wide)
                out.add("context_evidence", wide_mass.dtype, wide_mass.shape).extend(wide_mass)
        if dogma:
            moved = Store(folder).claim("dogma", {"filter": {"frame": frame}})
            with DriveWriter(folder, name, "dogma", moved, {}) as out:
                for array, values in dynamic.items():
                    out.add(array, values.dtype, values.shape).extend(values)
        if name in moving:
            box = np.where(labels == OCCUPIED, MOVES, NO_BOX).astype(np.uint8)
            with DriveWriter(folder, name, "moving", Store(folder).claim("moving", {"slowest": 0.5}), {}) as out:
                out.add("moving", box.dtype, box.shape).extend(box)
    return folder
