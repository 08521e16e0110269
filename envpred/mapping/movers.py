"""What moves on its own: cells taken out of the static world and carried on by their velocities."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from envpred.mapping.geometry import FloatArray

Grids = NDArray[np.float32]
Moved = tuple[NDArray[np.int64], Grids]


@dataclass(frozen=True)
class Movers:
    """Cells that move, taken out of the world and carried on by their velocities.

    Args:
        cell: (M, 2) lattice cells at the last frame shown.
        velocity: (M, 2) in m/s relative to the ground, east and north.
        deviation: (M, 3) Cholesky factor (xx, yx, yy) of the velocities' covariance, m/s.
        hit: (M,) or (M, N) probability of a hit where the cell has moved to, at each horizon.
    """

    cell: NDArray[np.int64]
    velocity: Grids
    deviation: Grids
    hit: Grids


def carried_on(
    movers: Movers | None, draw: FloatArray | None, horizons: int, period: float, resolution: float
) -> Moved:
    """Where each mover is at each horizon, (N, M, 2) lattice cells, and its probability of a hit there (N, M)."""
    if movers is None or not len(movers.cell):
        return np.zeros((horizons, 0, 2), np.int64), np.zeros((horizons, 0), np.float32)
    velocity = movers.velocity.astype(np.float64)
    if draw is not None:
        xx, yx, yy = movers.deviation.astype(np.float64).T
        velocity = velocity + np.stack([xx * draw[0], yx * draw[0] + yy * draw[1]], axis=1)
    ahead = np.arange(1, horizons + 1)[:, None, None] * (period / resolution)
    cells = np.floor(movers.cell + velocity * ahead + 0.5).astype(np.int64)
    hit = movers.hit if movers.hit.ndim == 2 else np.repeat(movers.hit[:, None], horizons, axis=1)
    return cells, np.ascontiguousarray(hit.T, np.float32)
