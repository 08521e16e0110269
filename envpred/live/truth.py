"""What is known of a drive beside its scans: boxes of what is around the ego, and the class of every point."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from envpred.drives.drive import Drive
from envpred.drives.kitti import KittiDrive
from envpred.drives.tracklets import Tracklet
from envpred.errors import UserError


@dataclass(frozen=True)
class Truth:
    """Tracklets and labels of a drive, as far as it has any.

    Args:
        tracklets: boxes in the sensor frame.
        labels: folder of SemanticKITTI's words, a file a scan.
    """

    tracklets: Sequence[Tracklet] = ()
    labels: Path | None = None

    @classmethod
    def of(cls, drive: Drive) -> Self:
        """What there is of `drive`.

        Raises:
            UserError: if its boxes cannot be read.
        """
        labels = drive.folder / "labels" if isinstance(drive, KittiDrive) else None  # the simulator's drives have them
        return cls(drive.tracklets(), labels if labels is not None and labels.is_dir() else None)

    def classes(self, frame: int, points: int) -> NDArray[np.uint32] | None:
        """Words (N,) of the points of a frame, class and instance, where they are known.

        Raises:
            UserError: if there are not as many as `points`.
        """
        file = None if self.labels is None else self.labels / f"{frame:010d}.label"
        if file is None or not file.is_file():
            return None
        words = np.fromfile(file, "<u4")
        if len(words) != points:
            raise UserError(f"{file}: has {len(words)} labels for {points} points; copy both again, or delete it")
        return words
