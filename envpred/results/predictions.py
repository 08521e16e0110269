"""Predictions on disk: a folder of forecasts, one plain `.npy` a window, and a manifest that says what they are.

    predictions/manifest.json                          how they were made, and the windows
    predictions/<drive>/<last frame shown>.npy         probability of occupied (horizons, H, W)

The folder appears by one rename when all is written.
"""

import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from envpred.errors import UserError
from envpred.gate import ArraySchema, read_array, read_json
from envpred.gate.runs import PredictionsManifest
from envpred.mapping.evidence import pignistic
from envpred.mapping.geometry import heading_of
from envpred.results.names import method_name
from envpred.results.scenes import Scene
from envpred.store import MANIFEST, Store, StoredDrive
from envpred.store.files import inside

FORMAT = 2
WHAT = (
    "probability of occupied (horizon, i, j), i to the east, j to the north; cell (i, j) lies (i - cells/2, "
    "j - cells/2) cells from the cell that holds the ego at that horizon, not at the last frame shown"
)


def window_entry(drive: StoredDrive, start: int, given: int, horizons: int) -> dict[str, Any]:
    """What a manifest says about a window: its frames, and where the grid of the last frame shown lies.

    `targets` counts the frames after it that the drive has without a gap, at most `horizons`.
    """
    last = start + given - 1
    end = next(first + length for first, length in drive.stretches if first <= last < first + length)
    targets = min(horizons, end - last - 1)
    pose, centre_cell = np.array(drive.array("pose")[last]), drive.array("centre_cell")
    return {
        "drive": drive.name,
        "start": start,
        "start_frame": drive.frames[start],
        "frames": drive.frames[start : last + 1],
        "pose": {"east_m": pose[0, 3], "north_m": pose[1, 3], "heading_rad": float(heading_of(pose))},
        "centre_cell": centre_cell[last].tolist(),
        "targets": targets,
        "target_centre_cell": centre_cell[last + 1 : last + 1 + targets].tolist(),
    }


def drive_entry(drive: StoredDrive) -> dict[str, Any]:
    """What a manifest says about a drive: where its lattice lies in the drive's world, and which grids it was."""
    lattice = drive.manifest["lattice"]
    return {
        "lattice_origin_m": lattice["origin"],
        "resolution_m": lattice["resolution"],
        "cells": lattice["cells"],
        "evidence_checksum": drive.manifest["arrays"]["evidence"]["checksum"],
    }


class Predictions:
    """A folder of forecasts that `envpred predict` wrote.

    Raises:
        UserError: if it is none, or of another format.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        if not (folder / MANIFEST).is_file():
            raise UserError(
                f"{folder}: holds no predictions ({MANIFEST} is missing); write some with `envpred predict`"
            )
        self.manifest: dict[str, Any] = read_json(folder / MANIFEST, PredictionsManifest, self._remedy, FORMAT)

    @property
    def _remedy(self) -> str:
        return f"delete {self.folder} and run `envpred predict` again"  # which leaves a folder that holds files alone

    @property
    def windows(self) -> list[dict[str, Any]]:
        """What the manifest says about each window."""
        return cast(list[dict[str, Any]], self.manifest["windows"])

    @property
    def label(self) -> str:
        """What the method is called."""
        return method_name(self.manifest["model"], self.manifest["role"], self.manifest["variant"])

    def forecast(self, k: int) -> NDArray[np.float32]:
        """Probability of occupied (horizons, H, W) of window `k`.

        Raises:
            UserError: if its file is missing, or not what the manifest says.
        """
        window = self.windows[k]
        file = inside(self.folder, window["file"], self.folder / MANIFEST)
        cells = self.manifest["drives"][window["drive"]]["cells"]
        array = read_array(file, ArraySchema("f", (len(self.manifest["horizon_s"]), cells, cells)), self._remedy)
        if zlib.crc32(array.tobytes()) != window["checksum"]:
            raise UserError(f"{file}: changed since it was written; {self._remedy}")
        return np.asarray(array, np.float32)

    def scene(self, k: int, store: Store | None = None, method: str | None = None) -> Scene:
        """Window `k` as a picture shows it, with frames shown and targets if the `store` is given.

        Raises:
            UserError: if the window cannot be read, or the store holds other grids than those forecast from.
        """
        window, forecast = self.windows[k], self.forecast(k)
        frames, name, method = tuple(window["frames"]), window["drive"], method or self.label
        scene = Scene(
            name,
            frames,
            np.empty((0, *forecast.shape[1:]), np.float32),
            np.empty((0, *forecast.shape[1:]), np.float32),
            np.empty((0, 2), np.int64),
            {method: forecast},
            self.manifest["drives"][name]["resolution_m"],
            self.manifest["horizon_s"][0],
            oracles=frozenset({method} if self.manifest["role"] == "oracle" else ()),
        )
        if store is not None:
            drive, start, now = store.drives.get(name), window["start"], window["start"] + len(frames)
            if (
                drive is None
                or drive_entry(drive) != self.manifest["drives"][name]
                or drive.frames[start:now] != window["frames"]
                or now + window["targets"] > len(drive.frames)
            ):
                raise UserError(
                    f"{store.folder}: does not hold the grids of {name} that {self.folder} was forecast from; "
                    "give their store as --store, or run `envpred predict` again"
                )
            cut = slice(start, now + window["targets"])
            occupancy = pignistic(np.array(drive.array("evidence")[cut], np.float32))
            context = None
            if self.manifest["data"].get("context"):
                context = pignistic(np.array(drive.array("context_evidence")[now - 1], np.float32))
            scene = replace(
                scene,
                seen=occupancy[: len(frames)],
                target=occupancy[len(frames) :],
                centre_cell=np.array(drive.array("centre_cell")[cut], np.int64),
                context=context,
            )
        return scene
