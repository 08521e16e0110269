"""What moves on its own: cells taken out of the static world and carried on by their velocities."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from envpred.errors import UserError
from envpred.mapping.dogma import is_moving
from envpred.mapping.geometry import OCCUPIED, FloatArray
from envpred.mapping.world import Grids, World

Moved = tuple[NDArray[np.int64], Grids]


@dataclass(frozen=True)
class Movers:
    """Cells that move, taken out of the world and carried on by their velocities.

    Args:
        cell: (M, 2) lattice cells at the last frame shown.
        velocity: (M, 2) in m/s relative to the ground, east and north.
        deviation: (M, 3) Cholesky factor (xx, yx, yy) of the velocities' covariance, m/s.
        hit: (M, N) probability of a hit where the cell has moved to, at each horizon.
    """

    cell: NDArray[np.int64]
    velocity: Grids
    deviation: Grids
    hit: Grids


@dataclass(frozen=True)
class Moving:
    """Which cells move, and how they are carried on.

    Args:
        tau: a cell moves if the squared Mahalanobis distance of its velocity from 0 exceeds this.
        slowest: and if it is faster than this, in m/s.
        share: of the probability of a hit that leaves the cell with what moves; the rest stays.
        trail: cells around what moves where hits that the last frame does not have any more are its trail, and go too.
        hit: probability that a moved cell is hit one frame later.
        lasting: factor on it for every further frame.
        spread: factor on the velocities' deviation.
    """

    tau: float = 4.0
    slowest: float = 0.5
    share: float = 1.0
    trail: int = 3
    hit: float = 0.75
    lasting: float = 0.98
    spread: float = 0.5

    def split(
        self,
        world: World,
        label: NDArray[np.uint8],
        velocity: NDArray[np.floating],
        covariance: NDArray[np.floating],
        centre_cell: NDArray[np.integer],
        horizons: int,
        frame: str,
    ) -> tuple[World, Movers]:
        """The `world` without what moves, and what moves.

        Args:
            world: what scans meet, on the context grid.
            label: (H, H) label codes of the last frame shown, the judged grid's.
            velocity: (2, H, H) of its cells, m/s.
            covariance: (3, H, H) of that, xx, xy, yy.
            centre_cell: (2,) lattice cell at the grid's centre.
            horizons: frames ahead.
            frame: what velocities are relative to, see `ParticleFilterParameters.frame`.

        Raises:
            UserError: if velocities are relative to the ego.
        """
        if frame != "ground":
            raise UserError(
                f"velocities are relative to the {frame}, and movers need them relative to the ground; build the grids "
                "with --config ground_velocity"
            )
        i, j = np.nonzero((label == OCCUPIED) & (np.hypot(*velocity) > self.slowest))
        # Of few cells: on all of them torch's threads would take part, and spin beside those that cast rays.
        speed, spread = (torch.from_numpy(np.asarray(a[:, i, j, None], np.float32)) for a in (velocity, covariance))
        moving = is_moving(speed, spread, self.tau)[:, 0].numpy()
        i, j = i[moving], j[moving]
        around = np.zeros(label.shape, np.bool_)
        around[i, j] = True
        around = maximum_filter(around, 2 * self.trail + 1) & ((label != OCCUPIED) | around)
        rim = (world.cells - label.shape[-1]) // 2
        hit = world.hit.copy()
        gone = np.argwhere(around) + rim - world.first
        gone = gone[((gone >= 0) & (gone < hit.shape[1:])).all(axis=1)]
        hit[:, gone[:, 0], gone[:, 1]] *= np.float32(1 - self.share)
        xx, xy, yy = np.asarray(covariance)[:, i, j].astype(np.float64)
        a = np.sqrt(np.maximum(xx, 1e-6))
        c = np.sqrt(np.maximum(yy - (xy / a) ** 2, 0))
        ahead = self.hit * self.lasting ** np.arange(horizons)
        movers = Movers(
            cell=np.stack([i, j], axis=1) + np.asarray(centre_cell, np.int64) - label.shape[-1] // 2,
            velocity=np.asarray(velocity, np.float32)[:, i, j].T,
            deviation=(self.spread * np.stack([a, xy / a, c], axis=1)).astype(np.float32),
            hit=np.tile(ahead.astype(np.float32), (len(i), 1)),
        )
        return replace(world, hit=hit), movers


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
    return cells, np.ascontiguousarray(movers.hit.T, np.float32)
