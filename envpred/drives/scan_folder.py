"""A folder of scans: which there are, how they are numbered, and their points along the car's axes."""

import re
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from envpred.drives.clouds import READERS, Columns, read_cloud
from envpred.drives.plausible import check_points
from envpred.drives.pose_files import SECONDS
from envpred.errors import UserError
from envpred.gate.folders import Deskew, Scans
from envpred.mapping.deskew import since_start
from envpred.mapping.geometry import FloatArray

INTENSITY = ("intensity", "reflectance", "reflectivity", "remission", "i", "scalar_Intensity", "scalar_intensity")
TIME = ("time", "t", "timestamp", "time_stamp", "timestamps", "offset_time", "time_offset")
STAMP = {"start": 0.0, "middle": 0.5, "end": 1.0}  # shares of a sweep that have passed when a scan is stamped
NUMBERS = 2**31  # names of scans that are numbers up to here count them; larger ones are times


class Sweep(NamedTuple):
    """The points of a scan as they were measured.

    Args:
        points: (N, 4) x forward, y left, z up and reflectance.
        columns: further columns of the file by name, (N,) each.
        file: that they are from.
    """

    points: NDArray[np.float32]
    columns: Columns
    file: Path


class ScanFolder:
    """The scans of one folder, in the order of the numbers in their names, else of their names.

    Args:
        folder: that holds them.
        said: of their columns and axes.
        levelled: rotation (3, 3) from their own axes to those of the car.
        settings: file that says so.
    """

    def __init__(self, folder: Path, said: Scans, levelled: FloatArray, settings: Path) -> None:
        self.folder, self.said, self.levelled, self.settings = folder, said, levelled, settings

    @cached_property
    def files(self) -> list[Path]:
        """The scans.

        Raises:
            UserError: if there are none, or of several kinds.
        """
        try:
            files = [file for file in self.folder.iterdir() if file.suffix in READERS]
        except OSError as error:
            raise UserError(
                f"{self.folder}: no folder of scans ({error.strerror}); mend `scans: folder` in {self.settings}"
            ) from None
        kinds = sorted({file.suffix for file in files})
        if len(kinds) != 1:
            what = f"scans of several kinds ({', '.join(kinds)})" if kinds else f"no scans ({', '.join(READERS)})"
            raise UserError(f"{self.folder}: holds {what}; mend `scans: folder` in {self.settings}")
        return sorted(files, key=lambda file: (_number(file.stem), file.stem))

    @cached_property
    def numbers(self) -> list[int]:
        """Numbers of the frames: those that the scans are named with, unless these are times, else their places."""
        stems = [file.stem for file in self.files]
        if all(stem.isdecimal() and len(stem) < 11 and int(stem) < NUMBERS for stem in stems):
            numbers = [int(stem) for stem in stems]
            if len(set(numbers)) == len(numbers):
                return numbers
        return list(range(len(stems)))

    @property
    def stride(self) -> int:
        """How much the numbers of scans that follow each other differ."""
        return int(np.diff(self.numbers).min()) if len(self.numbers) > 1 else 1

    @cached_property
    def position(self) -> dict[int, int]:
        """Place of each frame among `files`, by its number."""
        return {k: n for n, k in enumerate(self.numbers)}

    def sweep(self, k: int) -> Sweep:
        """The points of frame `k`; what did not return is left out.

        Raises:
            UserError: if the file is missing, damaged, empty or holds what cannot be a scan in metres.
        """
        file = self.files[self.position[k]]
        columns = read_cloud(file, self.said.columns)
        raw = np.stack([columns[axis].astype(np.float64) for axis in "xyz"], axis=1) * self.said.scale
        returned = np.isfinite(raw).all(axis=1) & (raw != 0).any(axis=1)  # organised clouds hold what did not return
        if not returned.any():
            raise UserError(f"{file}: an empty scan; copy it again, or delete it to leave a gap in the drive")
        points = np.zeros((int(returned.sum()), 4), np.float32)
        with np.errstate(over="ignore"):  # what is beyond float32 is refused below
            points[:, :3] = raw[returned] @ self.levelled.T
            name = _column("intensity", self.said.intensity, INTENSITY, columns, file)
            if name is not None:
                points[:, 3] = np.nan_to_num(columns[name][returned].astype(np.float32))
        check_points(file, points)
        return Sweep(points, {name: column[returned] for name, column in columns.items()}, file)

    def since_stamp(self, sweep: Sweep, how: Deskew, period: float) -> FloatArray:
        """Seconds (N,) from the moment that a scan is stamped with to the one at which each point was measured.

        Args:
            sweep: the scan.
            how: its points are timed.
            period: nominal time between scans in seconds.

        Raises:
            UserError: if its points have no times, or such as no sweep takes.
        """
        if how.by == "azimuth":
            since, length = since_start(sweep.points, period, how.turn == "clockwise", np.radians(how.start)), period
        else:
            name = self.time_column(sweep)
            if name is None:
                raise UserError(
                    f"{sweep.file}: its points have no times; name their column under `scans: time`, or write "
                    "`deskew: {by: azimuth}`"
                )
            times = sweep.columns[name].astype(np.float64)
            since = (times - times.min()) * SECONDS[how.unit]
            length = float(since.max())
            if not length <= 2 * period:  # also of what is no number
                raise UserError(
                    f"{sweep.file}: its points take {length:.4g} s, where scans are {period:.3g} s apart; mend "
                    "`deskew: unit`"
                )
        return since - STAMP[how.stamp] * length

    def time_column(self, sweep: Sweep) -> str | None:
        """Name of the column that holds the points' times, if one does.

        Raises:
            UserError: if the one that the settings name is not there.
        """
        return _column("time", self.said.time, TIME, sweep.columns, sweep.file)


def _column(key: str, said: str | None, usual: tuple[str, ...], columns: Columns, file: Path) -> str | None:
    if said is not None and said not in columns:
        raise UserError(f"{file}: has no column {said}, only {', '.join(columns)}; mend `scans: {key}`")
    return said or next((name for name in usual if name in columns), None)


def _number(stem: str) -> float:
    """The number that a name ends in, or is; infinite if it has none."""
    found = re.search(r"\d+(\.\d+)?$", stem)
    return float(found[0]) if found else np.inf
