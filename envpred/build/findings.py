"""What a check says, and the words of a recording's settings that it is said in."""

from typing import NamedTuple

import numpy as np

from envpred.drives import Drive
from envpred.drives.axes import CAR, names_of
from envpred.drives.folder import FolderDrive
from envpred.mapping.geometry import FloatArray


class Finding(NamedTuple):
    """One thing that looks wrong.

    Args:
        what: it is, in a few words.
        how: it shows.
        mend: what to do; empty where `how` says it.
    """

    what: str
    how: str
    mend: str

    def __str__(self) -> str:
        return f"{self.what}: {self.how}" + (f"; {self.mend}" if self.mend else "")


class Settings(NamedTuple):
    """What a drive's settings say of its frames.

    Args:
        file: of the settings, or what a reader of a fixed layout has instead.
        scan_axes: (3, 3) from the scans' own axes to those that they are given in.
        pose_axes: (3, 3) from the axes of what poses are of to those that they are given in.
        folder: the drive, where it has settings of its own.
    """

    file: str
    scan_axes: FloatArray
    pose_axes: FloatArray
    folder: FolderDrive | None

    @classmethod
    def of(cls, drive: Drive) -> "Settings":
        """Those of `drive`."""
        if not isinstance(drive, FolderDrive):
            return cls("its calibration", np.eye(3), np.eye(3), None)
        return cls(str(drive.settings), drive.scans.levelled, drive.track.pose_axes, drive)

    def axes(self, kind: str, further: FloatArray) -> str:
        """How the settings name axes that are `further` (3, 3) turned than now; `kind`: scans or poses."""
        now = self.scan_axes if kind == "scans" else self.pose_axes
        return f"axes: {names_of(further @ now, CAR)}"

    def write(self, text: str) -> str:
        """The remedy to write `text` into the settings."""
        return f"write `{text}` in {self.file}" if self.folder else f"mend {self.file}, as for `{text}`"
