"""Axes by name: which way x, y and z point, as rotations."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from envpred.errors import UserError
from envpred.mapping.geometry import FloatArray

CAR = {
    "forward": (1, 0, 0), "backward": (-1, 0, 0), "left": (0, 1, 0), "right": (0, -1, 0), "up": (0, 0, 1),
    "down": (0, 0, -1),
}  # fmt: skip
WORLD = {
    "east": (1, 0, 0), "west": (-1, 0, 0), "north": (0, 1, 0), "south": (0, -1, 0), "up": (0, 0, 1), "down": (0, 0, -1),
}  # fmt: skip


def rotation_of(axes: Sequence[str], names: dict[str, tuple[int, int, int]], where: Path | str, key: str) -> FloatArray:
    """The rotation (3, 3) that takes coordinates along the named `axes` to those along x, y and z of `names`.

    Args:
        axes: where x, y and z point.
        names: `CAR` (forward, left, up) or `WORLD` (east, north, up).
        where: file that names them.
        key: under which it does.

    Raises:
        UserError: if two of them are along one line, or they are a mirror image of a right-handed system.
    """
    rotation = np.array([names[axis] for axis in axes], np.float64).T
    determinant = round(float(np.linalg.det(rotation)))
    if determinant != 1:
        why = "mirror the world (left-handed)" if determinant else "do not stand at right angles"
        told = ", ".join(axes)
        raise UserError(f"{where}: {key}: x, y, z along [{told}] {why}; name where each axis points")
    return rotation


def names_of(rotation: FloatArray, names: dict[str, tuple[int, int, int]]) -> str:
    """The names of the axes whose `rotation_of` is nearest to `rotation` (3, 3), as YAML writes them."""
    return f"[{', '.join(max(names, key=lambda name: float(np.dot(names[name], axis))) for axis in rotation.T)}]"
