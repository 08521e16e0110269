"""What stands beside a road that has no pavement: grass, trees, hedges and fences, houses and woods behind."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from envpred.simulate import furniture
from envpred.simulate.mesh import Mesh

BARRIERS = ("hedge", "fence", "wall")
_RAIL = 0.9  # metres: height of a guard rail


class Standing(NamedTuple):
    """Something beside a road.

    Attributes:
        kind: "tree", "bush", "sign", "house", or a barrier: "hedge", "fence", "wall".
        along: metres along the road; of a barrier or house, where it begins.
        side: metres from the road's edge.
        length: of a barrier or house along the road, metres.
        height: metres.
        radius: of a crown or bush, metres.
    """

    kind: str
    along: float
    side: float
    length: float = 0.0
    height: float = 0.0
    radius: float = 0.0

    def model(self, rng: np.random.Generator) -> Mesh:
        """A tree, bush or sign; it faces along x."""
        if self.kind == "tree":
            return furniture.tree(self.height, self.radius, 0.3 * self.height, rng)
        if self.kind == "bush":
            return furniture.bush(self.radius, self.height, rng)
        return furniture.sign(self.height)


def verge(length: float, rng: np.random.Generator) -> Iterator[Standing]:
    """What stands along one side of `length` metres of road: at the road, on the open land, and behind it."""
    for start, stretch in _stretches(length, (20.0, 80.0), rng):
        yield from _roadside(start, stretch, rng)
    for start, stretch in _stretches(length, (20.0, 60.0), rng):
        yield from _behind(start, stretch, rng.uniform(11, 26), rng)
    for along in rng.uniform(0, length, rng.poisson(length / 14)):
        yield _tree(float(along), rng.uniform(3, 20), rng)
    for along in rng.uniform(0, length, rng.poisson(length / 90)):
        yield Standing("sign", float(along), 0.9, height=rng.uniform(1.2, 2.6))


def _stretches(length: float, span: tuple[float, float], rng: np.random.Generator) -> Iterator[tuple[float, float]]:
    start = 0.0
    while start < length - 4:
        stretch = min(rng.uniform(*span), length - start)
        yield start, stretch
        start += stretch


def _roadside(start: float, stretch: float, rng: np.random.Generator) -> Iterator[Standing]:
    kind = rng.choice(
        ["grass", "hedge", "wall", "rail", "fence", "trees", "thicket"], p=[0.26, 0.16, 0.08, 0.1, 0.1, 0.2, 0.1]
    )
    if kind in ("hedge", "wall", "fence"):
        yield Standing(str(kind), start, rng.uniform(1.5, 4.5), stretch, rng.uniform(0.9, 2.2))
    elif kind == "rail":
        yield Standing("fence", start, 0.8, stretch, _RAIL)
    elif kind == "trees":
        side, between = rng.uniform(1.8, 4.0), rng.uniform(6, 12)
        for along in np.arange(start + 1, start + stretch, between):
            yield _tree(float(along + rng.normal(0, 0.4)), float(side + rng.normal(0, 0.3)), rng)
    plants = 0.6 if kind == "thicket" else 0.1  # bushes a metre
    for along in rng.uniform(start, start + stretch, rng.poisson(plants * stretch)):
        yield _bush(float(along), 1.3 + rng.gamma(1.5, 1.8), rng)


def _behind(start: float, stretch: float, side: float, rng: np.random.Generator) -> Iterator[Standing]:
    kind = rng.choice(["houses", "wood", "barrier", "fields"], p=[0.38, 0.27, 0.2, 0.15])
    if kind == "houses":
        along = start
        while along < start + stretch - 7:
            front = rng.uniform(8, 15)
            yield Standing("house", along, side, front, rng.uniform(4.5, 8.0))
            along += front + rng.uniform(2, 9)
    if kind == "barrier" or (kind == "houses" and rng.random() < 0.6):
        what = str(rng.choice(["hedge", "hedge", "fence", "wall"]))
        yield Standing(what, start, side - rng.uniform(2, 6), stretch, rng.uniform(1.0, 2.6))
    for along in rng.uniform(start, start + stretch, rng.poisson(0.35 * stretch if kind == "wood" else 0.05 * stretch)):
        yield _tree(float(along), side + rng.normal(0, 2.0), rng)
    for along in rng.uniform(start, start + stretch, rng.poisson(0.8 * stretch if kind == "wood" else 0.1 * stretch)):
        yield _bush(float(along), side + rng.normal(0, 1.5), rng)


def _tree(along: float, side: float, rng: np.random.Generator) -> Standing:
    height = rng.uniform(4.0, 9.5)
    return Standing("tree", along, side, height=height, radius=height * rng.uniform(0.16, 0.26))


def _bush(along: float, side: float, rng: np.random.Generator) -> Standing:
    return Standing("bush", along, side, height=rng.uniform(0.5, 1.9), radius=rng.uniform(0.35, 1.1))
