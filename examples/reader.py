"""A reader of your own: `envpred grids --reader reader.find --source FOLDER --store grids/` in this file's folder.

The layout read here: a folder a drive, with `<number>.npy` scans (N, 4) and a `poses.npy` (T, 4, 4), ten a second.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from envpred.drives import Drive


class NumpyDrive(Drive):
    """One folder of scans as NumPy writes them."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.name = folder, folder.name

    @property
    def frames(self) -> list[int]:
        return sorted(int(file.stem) for file in self.folder.glob("[0-9]*.npy"))

    def scan(self, k: int) -> NDArray[np.float32]:
        points: NDArray[np.float32] = np.load(self.folder / f"{k}.npy", allow_pickle=False)
        return points

    def pose(self, k: int) -> NDArray[np.float64]:
        pose: NDArray[np.float64] = np.load(self.folder / "poses.npy", allow_pickle=False)[k]
        return pose

    def time(self, k: int) -> float:
        return 0.1 * k

    def sensor_to_body(self) -> NDArray[np.float64]:
        return np.eye(4)


def find(root: Path) -> list[Drive]:
    """Drives in the folders below `root`."""
    return [NumpyDrive(file.parent) for file in sorted(root.glob("*/poses.npy"))]
