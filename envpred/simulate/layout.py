"""What stands along the streets of a town: houses with gaps and yards, fences, trees, furniture, parked cars."""

from dataclasses import dataclass, field

import numpy as np

from envpred.simulate import furniture, models
from envpred.simulate.mesh import FloatArray, Mesh
from envpred.simulate.streets import BAY
from envpred.simulate.terrain import CELL, MARGIN, Terrain
from envpred.simulate.traffic import KINDS, LANES, Network
from envpred.simulate.verges import BARRIERS, verge

Span = tuple[float, float]


@dataclass(frozen=True)
class Style:
    """How a town is built; spans are drawn from uniformly, metres."""

    setback: Span = (2.0, 6.0)
    frontage: Span = (9.0, 16.0)
    gap: Span = (2.5, 6.0)
    gaps: float = 0.6  # share of houses with a gap beside them
    height: Span = (6.0, 11.0)
    yards: float = 0.2  # share of lots without a house
    fenced: float = 0.7  # share of front gardens with a hedge, wall or fence
    alley: float = 0.3  # share of pavements with a row of trees
    gardens: float = 0.7  # trees and bushes for each lot
    parked: float = 0.65  # share of a parking strip that is taken
    wild: float = 65.0  # square metres of land without a building for each tree or bush


STYLES = {
    "old_town": Style((0.0, 2.5), (9.0, 18.0), (2.5, 6.0), 0.4, (8.0, 15.0), 0.12, 0.75, 0.35, 2.8, 0.85),
    "residential": Style((2.5, 6.0), (9.0, 15.0), (3.0, 7.0), 0.7, (5.5, 9.0), 0.20, 0.85, 0.4, 5.2, 0.8),
    "boulevard": Style((1.5, 5.0), (12.0, 30.0), (3.0, 8.0), 0.6, (9.0, 18.0), 0.15, 0.7, 0.6, 7.0, 0.85),
    "suburb": Style((3.0, 7.0), (8.0, 14.0), (4.0, 10.0), 0.9, (4.5, 8.0), 0.22, 0.85, 0.4, 7.0, 0.75),
    "rural": Style((6.0, 14.0), (9.0, 15.0), (6.0, 20.0), 0.9, (4.5, 7.5), 0.55, 0.5, 0.5, 6.0, 0.6, wild=160.0),
    "arterial": Style((3.0, 9.0), (14.0, 34.0), (4.0, 14.0), 0.8, (6.0, 16.0), 0.30, 0.6, 0.7, 6.0, 0.6, wild=90.0),
    "crescents": Style((2.5, 6.5), (8.0, 13.0), (3.0, 8.0), 0.9, (4.5, 8.0), 0.18, 0.85, 0.3, 6.0, 0.75),
    "queues": Style((1.0, 5.0), (11.0, 26.0), (3.0, 8.0), 0.5, (8.0, 17.0), 0.18, 0.7, 0.5, 4.5, 0.85),
    "car_park": Style((3.0, 9.0), (18.0, 40.0), (6.0, 20.0), 0.9, (6.0, 10.0), 0.5, 0.5, 0.5, 4.0, 0.7, wild=55.0),
}


@dataclass(frozen=True)
class Parked:
    """Something that stays where it is and has a box: `kind` as in `traffic.KINDS`, or "parked_bicycle"."""

    kind: str
    length: float
    width: float
    light: bool
    place: tuple[float, float]
    heading: float

    def model(self) -> Mesh:
        if self.kind == "parked_bicycle":
            return models.parked_bicycle()
        return models.road_user(KINDS.index(self.kind), self.length, self.width, self.light)


@dataclass
class Layout:
    """Furnishes the ground around a path, street by street; `things` and `parked` fill up."""

    terrain: Terrain
    style: Style
    rng: np.random.Generator
    things: list[Mesh] = field(default_factory=list)
    parked: list[Parked] = field(default_factory=list)

    def furnish(self, network: Network) -> None:
        """Everything along every street within reach of the path."""
        self.taken = self.terrain.street()
        reach = self.terrain.from_path
        for kind, width, line in network.lanes:
            cells = self.terrain.cell(line)
            inside = np.abs(self.terrain.origin + cells * CELL - line).max(axis=1) < CELL
            if not (inside & (reach[cells[:, 0], cells[:, 1]] < MARGIN)).any():
                continue
            if LANES[kind] == "sidewalk":
                self._houses(line, width)
                self._pavement(line, width)
            elif LANES[kind] == "parking":
                self._parking(line, width)
            elif LANES[kind] in ("driving", "cycleway"):
                self._verge(line, width / 2)
        self._back_land()

    # One pavement at a time; `side` is metres away from the road, counted from the pavement's middle.

    def _houses(self, line: FloatArray, width: float) -> None:
        rng, style = self.rng, self.style
        edge, length = width / 2, _length(line)
        s = rng.uniform(0, 5)
        while s < length - 4:
            front = min(rng.uniform(*style.frontage), length - s)
            setback, depth = rng.uniform(*style.setback), rng.uniform(9, 13)
            built = rng.random() > style.yards and front > 5 and self._house(line, s, front, edge + setback, depth)
            if setback > 1.2 or not built:
                self._front_garden(line, s, front, edge, setback if built else 8.0)
            s += front
            if rng.random() < style.gaps:
                gap = rng.uniform(*style.gap)
                self._gap(line, s, gap, edge, setback)
                s += gap

    def _house(self, line: FloatArray, s: float, front: float, side: float, depth: float) -> bool:
        for share in (1.0, 0.7, 0.5):
            place, heading = _beside(line, s + front / 2, side + share * depth / 2)
            if self._claim(place, heading, share * front, share * depth):
                roof = self.rng.uniform(2, 4) if self.style.height[0] < 9 else 0.0
                height = self.rng.uniform(*self.style.height)
                house = furniture.house(share * front, share * depth, height, roof, self.rng)
                self._stand(house, place, heading + np.pi)  # a house's front looks towards -y
                return True
        return False

    def _front_garden(self, line: FloatArray, s: float, front: float, edge: float, depth: float) -> None:
        rng = self.rng
        gate = rng.uniform(1.0, 3.0)
        if rng.random() < self.style.fenced and front > gate + 3:
            kind = rng.choice(["hedge", "hedge", "wall", "fence"])
            height = rng.uniform(0.6, 1.9)
            opening = rng.uniform(1, front - gate - 1)
            for a, b in ((0.0, opening), (opening + gate, front)):
                self._barrier(str(kind), line, s + a, b - a, edge + 0.35, height)
        for _ in range(rng.poisson(self.style.gardens * (1.0 if depth < 7 else 2.0))):
            where = _beside(line, s + rng.uniform(0, front), edge + rng.uniform(1.0, max(depth, 1.1)))[0]
            self._plant(where)

    def _gap(self, line: FloatArray, s: float, gap: float, edge: float, setback: float) -> None:
        """Between two houses: a gate, a drive with a car, a garage further back, or nothing."""
        rng = self.rng
        what = rng.random()
        if what < 0.35:
            self._barrier(str(rng.choice(["wall", "fence", "hedge"])), line, s, gap, edge + 0.35, rng.uniform(1.0, 2.0))
        elif gap > 2.8 and what < 0.75:
            place, heading = _beside(line, s + gap / 2, edge + max(setback, 1.0) + rng.uniform(6.5, 9))
            if self._claim(place, heading, min(gap, 3.2), 5.5):
                self._stand(furniture.house(min(gap, 3.2), 5.5, 2.6, 0.0, rng), place, heading + np.pi)
            if rng.random() < 0.5:
                self._park(_beside(line, s + gap / 2, edge + 3.2), np.pi / 2, claim=True)

    def _barrier(self, kind: str, line: FloatArray, s: float, length: float, side: float, height: float) -> None:
        """A hedge, wall or fence in pieces that follow the street."""
        pieces = max(1, round(length / 6))
        part = length / pieces
        for k in range(pieces):
            place, heading = _beside(line, s + (k + 0.5) * part, side)
            if part < 0.6 or self._blocked(place, heading, part, 0.3):
                continue
            model = {
                "hedge": lambda: furniture.hedge(part + 0.1, self.rng.uniform(0.6, 1.4), height, self.rng),
                "wall": lambda: furniture.wall(part + 0.1, height),
                "fence": lambda: furniture.fence(part, max(height, 0.9)),
            }[kind]()
            self._stand(model, place, heading)

    def _pavement(self, line: FloatArray, width: float) -> None:
        """Along the kerb: lamps, trees in a row, signs; along the houses: bins, bicycles, people who wait."""
        rng, length, kerb = self.rng, _length(line), -width / 2 + 0.35
        for s in np.arange(rng.uniform(2, 20), length, rng.uniform(24, 36)):
            place, heading = _beside(line, float(s), kerb)
            self._stand(furniture.pole(rng.uniform(5, 8), rng.uniform(0.06, 0.1)), place, heading + np.pi / 2)
        if rng.random() < self.style.alley:
            size = rng.uniform(0.8, 1.3)
            for s in np.arange(rng.uniform(3, 9), length - 3, rng.uniform(8, 15)):
                crown = furniture.tree(
                    rng.uniform(6, 9) * size, rng.uniform(1.5, 2.4) * size, rng.uniform(2.2, 3.2), rng
                )
                self._stand(crown, _beside(line, float(s), kerb + 0.1)[0], rng.uniform(0, 6))
        if length > 12:
            for s in (length - rng.uniform(1, 3), rng.uniform(8, length - 4)):
                place, heading = _beside(line, s, kerb)
                self._stand(furniture.sign(rng.uniform(2.2, 3.0)), place, heading + np.pi)
        for s in rng.uniform(0, length, rng.poisson(length / 35)):
            place, heading = _beside(line, float(s), width / 2 - 0.3)
            what = rng.random()
            if what < 0.5:
                self._stand(furniture.bin_box(rng.uniform(0.5, 1.4), 0.5, rng.uniform(0.8, 1.3)), place, heading)
            elif what < 0.75:
                for k in range(int(rng.integers(1, 5))):
                    spot, along = _beside(line, float(s) + 0.6 * k, width / 2 - 0.6)
                    self._add(Parked("parked_bicycle", 1.75, 0.56, True, spot, along + np.pi / 2 + rng.normal(0, 0.1)))
            else:
                self._add(Parked("person", 0.5, 0.6, True, place, rng.uniform(-np.pi, np.pi)))

    def _verge(self, line: FloatArray, edge: float) -> None:
        """Along a road that borders on land; nothing where a pavement or another lane lies beside it."""
        length = _length(line)
        beside = self.terrain.cell(np.array([_beside(line, s, edge + 1.2)[0] for s in np.arange(0, length, 4.0)]))
        if self.taken[beside[:, 0], beside[:, 1]].mean() > 0.5:
            return
        for it in verge(length, self.rng):
            place, heading = _beside(line, it.along, edge + it.side)
            if it.kind == "house":
                self._house(line, it.along, it.length, edge + it.side, 11.0)
            elif it.kind in BARRIERS:
                self._barrier(it.kind, line, it.along, it.length, edge + it.side, it.height)
            elif not self._blocked(place, 0.0, 0.5, 0.5):
                self._stand(it.model(self.rng), place, heading + np.pi)

    def _parking(self, line: FloatArray, width: float) -> None:
        rng, length = self.rng, _length(line)
        s = rng.uniform(1, 6)
        while s < length - 6:
            if width >= BAY:
                if rng.random() < self.style.parked:
                    self._park(_beside(line, s + 1.3, rng.normal(0, 0.15)), rng.normal(np.pi / 2, 0.02))
                s += 2.6
            elif rng.random() < self.style.parked:
                s += self._park(_beside(line, s + 2.6, rng.normal(0, 0.12)), rng.normal(0, 0.02)) + rng.uniform(
                    0.5, 1.8
                )
            else:
                s += rng.uniform(3, 8)

    def _park(self, where: tuple[tuple[float, float], float], turn: float, claim: bool = False) -> float:
        """Parks a car or van at a place and heading; returns its length."""
        rng = self.rng
        kind = "van" if rng.random() < 0.12 else "car"
        length = rng.uniform(4.9, 5.6) if kind == "van" else rng.uniform(3.6, 4.8)
        width = 1.98 if kind == "van" else 1.62 + 0.12 * (length - 3.6)
        heading = where[1] + turn + (np.pi if turn > 1 and rng.random() < 0.5 else 0)
        if not claim or self._claim(where[0], heading, length, width):
            self._add(Parked(kind, round(length, 1), round(width, 2), rng.random() < 0.5, where[0], heading))
        return length

    def _plant(self, place: tuple[float, float]) -> None:
        rng = self.rng
        if self._blocked(place, 0.0, 1.0, 1.0):
            return
        if rng.random() < 0.45:
            self._stand(
                furniture.tree(rng.uniform(4, 9), rng.uniform(1.2, 2.6), rng.uniform(1.2, 2.4), rng), place, 0.0
            )
        else:
            self._stand(furniture.bush(rng.uniform(0.5, 1.3), rng.uniform(0.6, 2.0), rng), place, 0.0)

    def _back_land(self) -> None:
        """Trees and bushes away from the streets, tried at every `wild` square metres."""
        extent = np.array(self.terrain.shape) * CELL
        for place in self.rng.uniform(0, 1, (int(extent.prod() / self.style.wild), 2)) * extent + self.terrain.origin:
            self._plant((float(place[0]), float(place[1])))

    # Claims on the ground.

    def _footprint(self, place: tuple[float, float], heading: float, length: float, width: float) -> FloatArray:
        along, across = (np.linspace(-v / 2, v / 2, int(np.ceil(v / CELL)) + 1) for v in (length, width))
        x, y = (v.ravel() for v in np.meshgrid(along, across, indexing="ij"))
        c, s = np.cos(heading), np.sin(heading)
        corners: FloatArray = np.array(place) + np.stack([c * x - s * y, s * x + c * y], axis=1)
        return corners

    def _blocked(self, place: tuple[float, float], heading: float, length: float, width: float) -> bool:
        cells = self.terrain.cell(self._footprint(place, heading, length, width))
        return bool(self.taken[cells[:, 0], cells[:, 1]].any())

    def _claim(self, place: tuple[float, float], heading: float, length: float, width: float) -> bool:
        """Takes a rectangle of ground, unless something of it is taken."""
        cells = self.terrain.cell(self._footprint(place, heading, length, width))
        if self.taken[cells[:, 0], cells[:, 1]].any():
            return False
        self.taken[cells[:, 0], cells[:, 1]] = True
        return True

    def _add(self, thing: Parked) -> None:
        if self._within(thing.place):
            self.parked.append(thing)

    def _stand(self, model: Mesh, place: tuple[float, float], heading: float) -> None:
        if self._within(place):
            self.things.append(model.at(*place, float(self.terrain.height(np.array(place))), heading))

    def _within(self, place: tuple[float, float]) -> bool:
        offset = np.array(place) - self.terrain.origin
        if (offset < 0).any() or (offset > np.array(self.terrain.shape) * CELL).any():
            return False
        i, j = self.terrain.cell(np.array(place))
        return bool(self.terrain.from_path[i, j] < MARGIN)


def _length(line: FloatArray) -> float:
    return float(np.hypot(*np.diff(line, axis=0).T).sum())


def _beside(line: FloatArray, s: float, side: float) -> tuple[tuple[float, float], float]:
    """The place `s` metres along a line and `side` metres to its right, and the line's heading there."""
    step = np.diff(line, axis=0)
    reach = np.hypot(*step.T)
    ends = reach.cumsum()
    k = min(int(np.searchsorted(ends, s)), len(step) - 1)
    along = step[k] / max(reach[k], 1e-9)
    x, y = line[k] + (s - (ends[k] - reach[k])) * along + side * np.array([along[1], -along[0]])
    return (float(x), float(y)), float(np.arctan2(along[1], along[0]))
