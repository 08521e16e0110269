"""Turning and cropping a window: all of it in one place, so that nothing is left behind."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from envpred.datamodules import symmetry as turning

Field = NDArray[Any]
Kind = Literal["grid", "vector", "covariance"]

# What stored arrays (T, ..., H, W) hold, where it is more than grids of single numbers: on the third axis from the end,
# components east and north, or xx, xy and yy.
KINDS: dict[str, Kind] = {"velocity": "vector", "velocity_cov": "covariance"}
_TURN = {"vector": turning.turn_vector, "covariance": turning.turn_covariance}


@dataclass(frozen=True)
class Transform:
    """One of the eight symmetries of the square, then a square that is cut out, of everything that a window holds.

    Args:
        cells: along a side of the judged grid.
        symmetry: see `envpred.datamodules.symmetry`.
        crop: cells along a side of what is cut out of the judged grid; None for all of it.
        corner: south-west cell of the crop.
    """

    cells: int
    symmetry: int = 0
    crop: int | None = None
    corner: tuple[int, int] = (0, 0)

    def frames(self, frames: Field, vectors: tuple[tuple[int, int], ...]) -> Field:
        """Frames (T, C, H, H) of a variant whose pairs of channels `vectors` turn with the grid."""
        turned = turning.turn_grid(frames, self.symmetry)
        if self.symmetry and vectors:
            turned = turned.copy()
            for pair in vectors:
                channels = list(pair)
                turned[:, channels] = self._turned(frames[:, channels], "vector")
        return self._cut(turned)

    def stored(self, field: Field, kind: Kind = "grid") -> Field:
        """A stored array (T, ..., H, H) of the judged or the wide grid; what holds no grids stays as it is."""
        if field.ndim < 3 or field.shape[-1] != field.shape[-2] or field.shape[-1] < self.cells:
            return field
        return self._cut(self._turned(field, kind))

    def centre_cell(self, centre_cell: Field) -> Field:
        """Lattice cells (T, 2) at the centres of the grids."""
        turned = turning.turn_cell(centre_cell, self.symmetry)
        if self.crop is None:
            return turned
        shift = np.array(self.corner) + self.crop // 2 - self.cells // 2
        return np.asarray(turned + shift, turned.dtype)

    def pose(self, pose: Field) -> Field:
        """Poses (T, 3): x and y in cells of the lattice, heading in radians."""
        return turning.turn_pose(pose, self.symmetry) if self.symmetry else pose

    def in_body(self, pose: Field) -> Field:
        """A pose (3,) in the body frame, ahead, to the left and heading; in a mirrored world the left is the right."""
        return pose * np.array([1, -1, -1]) if turning.is_mirrored(self.symmetry) else pose

    def _turned(self, field: Field, kind: Kind) -> Field:
        turned = turning.turn_grid(field, self.symmetry)
        if kind == "grid" or not self.symmetry:
            return turned
        return np.moveaxis(_TURN[kind](np.moveaxis(turned, -3, -1), self.symmetry), -1, -3)

    def _cut(self, field: Field) -> Field:
        """What is cut out of a field; one on a wider grid keeps the margin that it has around the judged grid."""
        if self.crop is None:
            return field
        side = field.shape[-1] - self.cells + self.crop
        west, south = self.corner
        return field[..., west : west + side, south : south + side]
