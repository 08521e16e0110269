"""What makes returns come and go although nothing drives: leaves in the wind, blades of grass, edges."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from envpred.simulate.mesh import MATERIAL
from envpred.simulate.rays import Struck, Target, strike

_BEHIND = np.float32(0.03)  # metres behind a leaf at which a ray that passes it goes on
_LEAVES = 3  # at most so many leaves are passed by one ray
_BLADE = np.float32(1.5)  # metres, by which a blade of grass shortens a range at most
_EDGE = (np.float32(0.15), np.float32(1.8))  # metres between neighbouring ranges that one pulse blends


@dataclass(frozen=True)
class Clutter:
    """What makes returns come and go although nothing drives.

    Args:
        porosity: share of the rays that pass a leaf in their way, drawn anew for every scan: wind moves it.
        grass: mean height of the blades that a ray may meet before the ground they grow on, metres.
        mixed: share of the rays on an edge whose range lies between those of what is before and behind it.
        lost: share of the returns that get lost anyhow.
    """

    porosity: float = 0.3
    grass: float = 0.03
    mixed: float = 0.3
    lost: float = 0.006

    @classmethod
    def draw(cls, rng: np.random.Generator) -> "Clutter":
        """That of one drive: season, wind and weather differ."""
        return cls(rng.uniform(0.15, 0.75), rng.uniform(0.0, 0.05), rng.uniform(0.1, 0.5), rng.uniform(0.003, 0.012))


NO_CLUTTER = Clutter(0.0, 0.0, 0.0, 0.0)


def pass_leaves(
    struck: Struck,
    still: Target,
    start: NDArray[np.float32],
    rays: NDArray[np.float32],
    porosity: float,
    rng: np.random.Generator,
) -> None:
    """Lets a share of the rays that meet a leaf go on to what is behind it."""
    leaf = np.flatnonzero(np.isfinite(struck.distance) & (struck.material == MATERIAL["leaves"]))
    for _ in range(_LEAVES if porosity > 0 else 0):
        leaf = leaf[rng.random(len(leaf), np.float32) < porosity]
        if not len(leaf):
            return
        so_far = struck.distance[leaf] + _BEHIND
        behind = strike(still, start[leaf] + so_far[:, None] * rays[leaf], rays[leaf])
        behind.distance += so_far
        struck.put(leaf, behind)
        leaf = leaf[np.isfinite(behind.distance) & (behind.material == MATERIAL["leaves"])]


def graze(measured: NDArray[np.float32], struck: Struck, height: float, rng: np.random.Generator) -> None:
    """Ends rays at blades of grass, exponentially distributed in height, before the ground they grow on."""
    grass = np.flatnonzero(np.isfinite(measured) & (struck.material == MATERIAL["grass"]))
    blade = np.float32(height) * rng.standard_exponential(len(grass), np.float32)
    measured[grass] -= np.minimum(blade / np.maximum(struck.cosine[grass], np.float32(0.02)), _BLADE)


def blend(measured: NDArray[np.float32], mixed: float, rng: np.random.Generator) -> None:
    """Puts ranges on edges between both sides: a pulse that meets both is told apart only if they are far apart."""
    with np.errstate(invalid="ignore"):  # two rays into the sky
        gap = np.diff(measured)
    edge = np.flatnonzero((np.abs(gap) > _EDGE[0]) & (np.abs(gap) < _EDGE[1]))
    edge = edge[rng.random(len(edge), np.float32) < mixed]
    measured[edge] += gap[edge] * rng.random(len(edge), np.float32)
