"""Street networks to drive on: a few towns drawn from a seed, in SUMO's plain XML (nodes and edges)."""

from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

SIDEWALK, PARKING, CYCLEWAY, DRIVING = "sidewalk", "parking", "cycleway", "driving"


@dataclass(frozen=True)
class Town:
    """How a town's streets are laid out: junctions in a distorted grid, some streets left out, the rest bent."""

    name: str
    columns: int
    rows: int
    spacing: float  # mean distance of neighbouring junctions, metres
    jitter: float  # standard deviation of a junction's position, in shares of the spacing
    bend: float  # standard deviation of a street's sideways bend, in shares of its length
    missing: float  # share of the streets that are left out
    arterials: int  # rows (and columns) with two lanes a direction
    residential: float  # share of the other streets where 30 km/h holds
    parking: float  # share of kerbs with a parking strip
    kinds: tuple[str, str] = ("residential", "collector")  # of streets that are no arterials: `residential`, others
    sidewalks: float = 1.0  # share of the streets' sides with a sidewalk
    lights: float = 0.15  # share of the junctions off the arterials with traffic lights
    arcs: int = 0  # bends to alternating sides that each street consists of; even, so that junctions stay crossings
    points: int = 9  # of a street's centre line
    traffic: float = 1.0  # how many vehicles there are, in those of an ordinary town
    walkers: float = 1.0  # how many people there are, in those of an ordinary town
    cycles: float = 1.0  # how many of the vehicles are bicycles, likewise
    aisles: float = 0.0  # of a car park: metres between its rows, which are the first of `kinds`, columns the second


TOWNS = (
    Town("old_town", 6, 6, 78.0, 0.13, 0.05, 0.16, 0, 0.85, 0.85),
    Town("residential", 5, 5, 105.0, 0.10, 0.09, 0.20, 1, 0.75, 0.85),
    Town("boulevard", 5, 4, 140.0, 0.06, 0.03, 0.10, 2, 0.40, 0.80),
    Town("suburb", 5, 4, 125.0, 0.14, 0.12, 0.22, 1, 0.55, 0.70),
    Town(
        "rural", 3, 3, 420.0, 0.10, 0.05, 0.10, 0, 1.0, 0.0,
        ("rural", "rural"), sidewalks=0.1, lights=0.0, points=61, traffic=2.2, walkers=0.5, cycles=0.1,
    ),
    Town("arterial", 4, 4, 240.0, 0.04, 0.008, 0.20, 2, 0.40, 0.35, points=21, traffic=1.6, cycles=0.3),
    Town(
        "crescents", 5, 5, 112.0, 0.05, 0.0, 0.16, 0, 1.0, 0.5,
        ("crescent", "crescent"), lights=0.0, arcs=2, points=41, cycles=0.7,
    ),
    Town("queues", 4, 4, 100.0, 0.06, 0.03, 0.04, 2, 0.3, 0.6, lights=0.9, traffic=2.6, walkers=1.6, cycles=0.6),
    Town(
        "car_park", 4, 7, 95.0, 0.02, 0.0, 0.12, 0, 1.0, 1.0,
        ("aisle", "access"), sidewalks=0.5, lights=0.0, traffic=0.9, walkers=0.8, cycles=0.3, aisles=24.0,
    ),
)  # fmt: skip

_SPEED = {"arterial": 13.9, "collector": 13.9, "residential": 8.9, "rural": 13.2, "crescent": 5.3}  # limits, m/s
_SPEED |= {"aisle": 4.2, "access": 5.6}
_PRIORITY = {"arterial": "9", "rural": "9", "collector": "5", "residential": "3", "crescent": "3"}
_PRIORITY |= {"aisle": "2", "access": "3"}
BAY = 4.9  # metres: width of a strip where cars park across the street
_WIDTH = {SIDEWALK: 1.9, PARKING: 2.0, CYCLEWAY: 1.5, DRIVING: 3.0}
_ALLOW: dict[str, dict[str, str]] = {
    SIDEWALK: {"allow": "pedestrian"},
    PARKING: {"disallow": "all"},
    CYCLEWAY: {"allow": "bicycle"},
    DRIVING: {"disallow": "pedestrian rail tram"},
}


def write_network(town: Town, seed: int, folder: Path) -> tuple[Path, Path]:
    """Writes a town's junctions and streets to `folder`: (nodes file, edges file) for netconvert."""
    rng = np.random.default_rng(seed)
    places = _junctions(town, rng)
    streets = _streets(town, rng)
    degree = np.zeros(len(places), int)
    for a, b, _ in streets:
        degree[[a, b]] += 1
    arterial, through = (
        {n for a, b, kind in streets if kind in kinds for n in (a, b)}
        for kinds in (("arterial",), ("arterial", "rural"))
    )

    nodes = ET.Element("nodes")
    for n, (x, y) in enumerate(places):
        if degree[n]:
            lights = degree[n] >= 3 and (n in arterial or rng.random() < town.lights)
            ordinary = "priority" if n in through else "right_before_left"
            kind = "traffic_light" if lights else ordinary
            ET.SubElement(nodes, "node", id=f"n{n}", x=f"{x:.2f}", y=f"{y:.2f}", type=kind, radius="5.5")
    edges = ET.Element("edges")
    for a, b, kind in streets:
        middle = (_serpentine if town.arcs else _bend)(places[a], places[b], town, rng)
        for head, tail, points in ((a, b, middle), (b, a, middle[::-1])):
            _edge(edges, f"n{head}", f"n{tail}", points, kind, town, rng)
    files = folder / f"{town.name}.nod.xml", folder / f"{town.name}.edg.xml"
    ET.ElementTree(nodes).write(files[0])
    ET.ElementTree(edges).write(files[1])
    return files


def _junctions(town: Town, rng: np.random.Generator) -> np.ndarray:
    column, row = np.meshgrid(np.arange(town.columns), np.arange(town.rows), indexing="ij")
    grid = np.stack([column.ravel(), row.ravel()], axis=1).astype(float)
    shift = np.clip(rng.normal(0, town.jitter, grid.shape), -0.25, 0.25)
    places: np.ndarray = (grid + shift) * [town.spacing, town.aisles or town.spacing]
    return places


def _streets(town: Town, rng: np.random.Generator) -> list[tuple[int, int, str]]:
    """Pairs of junctions with the street's kind; no junction is cut off, because a spanning tree always stays."""
    index = np.arange(town.columns * town.rows).reshape(town.columns, town.rows)
    rows = set(rng.choice(town.rows - 2, town.arterials, replace=False) + 1)
    columns = set(rng.choice(town.columns - 2, min(town.arterials, 1), replace=False) + 1)
    pairs = [(i, j, i + 1, j) for i in range(town.columns - 1) for j in range(town.rows)]
    pairs += [(i, j, i, j + 1) for i in range(town.columns) for j in range(town.rows - 1)]
    parent = np.arange(index.size)

    def root(n: int) -> int:
        while parent[n] != n:
            n = int(parent[n])
        return n

    streets = []
    main = [(p[1] == p[3] and p[1] in rows) or (p[0] == p[2] and p[0] in columns) for p in pairs]
    order = sorted(range(len(pairs)), key=lambda k: (not main[k], rng.random()))
    for k in order:
        a, b = int(index[pairs[k][:2]]), int(index[pairs[k][2:]])
        joins = root(a) != root(b)
        if main[k] or joins or rng.random() > 2 * town.missing:  # about half the streets are needed to join
            parent[root(a)] = root(b)
            slow = pairs[k][1] == pairs[k][3] if town.aisles else rng.random() < town.residential
            streets.append((a, b, "arterial" if main[k] else town.kinds[0 if slow else 1]))
    return streets


def _bend(a: np.ndarray, b: np.ndarray, town: Town, rng: np.random.Generator) -> np.ndarray:
    """Points of a street from `a` to `b` that swings to one side (or, S-shaped, to both)."""
    along = b - a
    across = np.array([-along[1], along[0]])
    s = np.linspace(0, 1, town.points)[:, None]
    swing = rng.normal(0, town.bend) * np.sin(np.pi * s) ** 2
    swing = swing + rng.normal(0, town.bend / 3) * np.sin(2 * np.pi * s) * np.sin(np.pi * s)
    points: np.ndarray = a + s * along + swing * across
    return points


def _serpentine(a: np.ndarray, b: np.ndarray, town: Town, rng: np.random.Generator) -> np.ndarray:
    """Points of a street from `a` to `b` that turns all the time: circular arcs, left and right in turn."""
    half = np.radians(rng.uniform(48, 64))  # the angle between an arc's end and the straight from `a` to `b`
    s = np.linspace(0, town.arcs, town.points)
    arc = np.minimum(s.astype(int), town.arcs - 1)
    turned = half * (2 * (s - arc) - 1)
    along = arc + 0.5 + np.sin(turned) / (2 * np.sin(half))
    across = (-1.0) ** arc * (np.cos(turned) - np.cos(half)) / (2 * np.sin(half))
    step = (b - a) / town.arcs
    points: np.ndarray = a + along[:, None] * step + across[:, None] * np.array([-step[1], step[0]])
    return points


def _edge(
    edges: ET.Element, head: str, tail: str, points: np.ndarray, kind: str, town: Town, rng: np.random.Generator
) -> None:
    """One direction of a street, its lanes from the kerb inwards."""
    lanes = [SIDEWALK] if kind != "aisle" and (town.sidewalks == 1 or rng.random() < town.sidewalks) else []
    if rng.random() < {"arterial": 0.4, "access": 0.0}.get(kind, 1.0) * town.parking:
        lanes.append(PARKING)
    if kind == "arterial" or (kind in ("collector", "rural") and rng.random() < 0.4):
        lanes.append(CYCLEWAY)
    lanes += [DRIVING] * (2 if kind == "arterial" else 1)
    edge = ET.SubElement(
        edges,
        "edge",
        {"id": f"{head}{tail}", "from": head, "to": tail, "spreadType": "right"},
        numLanes=str(len(lanes)),
        speed=str(_SPEED[kind]),
        priority=_PRIORITY[kind],
        shape=" ".join(f"{x:.2f},{y:.2f}" for x, y in points),
    )
    for k, lane in enumerate(lanes):
        ET.SubElement(
            edge,
            "lane",
            {"index": str(k), "width": str(BAY if kind == "aisle" and lane == PARKING else _WIDTH[lane])}
            | _ALLOW[lane],
        )
