"""Records traffic in SUMO (extra `sim`): streets and the tracks of everybody on them, for `traffic.Recording`."""

import subprocess
import tempfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from envpred.errors import UserError, check_number
from envpred.simulate.streets import TOWNS, Town, write_network
from envpred.simulate.traffic import KINDS, LANES, Network, Recording, Track

INTERVAL = 0.5  # seconds between two recorded positions; the tracks are splines in between
_STEP = 0.1  # seconds of SUMO's own step
_WARM_UP = 60.0  # seconds of traffic before the recording starts

# Vehicle types: SUMO class, kind, share, length, width, desired speed factor.
_TYPES = (
    ("passenger", "car", 0.34, 4.75, 1.82, 1.0),
    ("passenger", "car", 0.22, 4.30, 1.79, 1.0),
    ("passenger", "car", 0.16, 3.75, 1.65, 0.95),
    ("delivery", "van", 0.10, 5.40, 2.00, 0.95),
    ("truck", "truck", 0.03, 7.80, 2.40, 0.85),
    ("bicycle", "bicycle", 0.13, 1.80, 0.65, 1.0),
    ("motorcycle", "bicycle", 0.02, 2.20, 0.80, 1.0),
)


def record(path: Path, seconds: float = 300.0, seed: int = 1, towns: tuple[Town, ...] = TOWNS) -> None:
    """Lets SUMO run `seconds` of traffic in each town and writes the recording to `path` (npz).

    Needs the extra `sim` (eclipse-sumo, libsumo, sumolib).

    Raises:
        UserError: without it, or if nothing could come of the numbers.
    """
    check_number("seconds", seconds, 10)  # less is too short for a drive
    check_number("seed", seed, 0, 2**31 - 1 - len(towns))  # each town has its own
    try:
        import libsumo
        import sumo
        import sumolib
    except ImportError as error:
        raise UserError(f"recording traffic needs SUMO ({error}): pip install 'envpred[sim]'") from error
    networks = []
    with tempfile.TemporaryDirectory() as folder:
        for k, town in enumerate(towns):
            net = _build(town, seed + k, Path(folder), Path(sumo.SUMO_HOME))
            trips = _write_trips(town, net, seed + k, seconds + _WARM_UP, sumolib)
            tracks = _run(libsumo, net, trips, seconds, seed + k)
            networks.append(Network(town.name, *_geometry(sumolib, net), tracks))
    Recording(INTERVAL, seconds, networks).save(path)


def _build(town: Town, seed: int, folder: Path, home: Path) -> Path:
    nodes, edges = write_network(town, seed, folder)
    out = folder / f"{town.name}.net.xml"
    command = [home / "bin" / "netconvert", "-n", nodes, "-e", edges, "-o", out, "--crossings.guess", "--walkingareas"]
    command += ["--no-turnarounds.except-deadend", "--junctions.corner-detail", "6", "--no-warnings"]
    done = subprocess.run(
        [str(c) for c in command], capture_output=True, encoding="utf-8", errors="replace", check=False
    )
    if done.returncode:
        raise UserError(f"netconvert failed on the network {town.name}: {done.stderr.strip()[-300:]}")
    return out


def _write_trips(town: Town, net: Path, seed: int, seconds: float, sumolib: Any) -> Path:
    """Cars, bicycles and people that start at random times between random streets; some cars stop on the way."""
    rng = np.random.default_rng(seed)
    edges = [e for e in sumolib.net.readNet(str(net)).getEdges() if e.allows("passenger")]
    paved = [e for e in edges if e.allows("pedestrian")]
    root = ET.Element("routes")
    share = np.array([t[2] * (town.cycles if t[1] == "bicycle" else 1.0) for t in _TYPES])
    for k, (group, _, _, length, width, factor) in enumerate(_TYPES):
        ET.SubElement(
            root,
            "vType",
            id=f"t{k}",
            vClass=group,
            length=str(length),
            width=str(width),
            speedFactor=f"normc({factor},0.1,0.6,1.3)",
            sigma="0.2",
            accel="1.9" if group == "passenger" else "1.2",
            decel="3.0",
            maxSpeed="5.5" if group == "bicycle" else "30",
        )
    area = len(edges) / 100
    starts: list[tuple[float, str, int]] = []
    starts += [(float(t), "vehicle", 0) for t in rng.uniform(0, seconds, int(seconds * 0.62 * area * town.traffic))]
    if len(paved) > 1:
        people = int(seconds * 0.4 * area * town.walkers)
        starts += [(float(t), "person", 0) for t in rng.uniform(0, seconds, people)]
    for k, (t, what, _) in enumerate(sorted(starts)):
        able = paved if what == "person" else edges
        a, b = rng.choice(len(able), 2, replace=False)
        source, target = able[a].getID(), able[b].getID()
        if what == "person":
            person = ET.SubElement(root, "person", id=f"p{k}", depart=f"{t:.1f}", departPos="random")
            ET.SubElement(person, "walk", {"from": source, "to": target, "speed": f"{rng.uniform(0.9, 1.7):.2f}"})
            continue
        kind = int(rng.choice(len(_TYPES), p=share / share.sum()))
        trip = ET.SubElement(
            root,
            "trip",
            {"id": f"v{k}", "type": f"t{kind}", "depart": f"{t:.1f}", "from": source, "to": target},
            departPos="random_free",
            departSpeed="desired",
            departLane="best",
        )
        if rng.random() < 0.06 and edges[b].getLength() > 50:  # a halt in the lane before the destination
            lane = edges[b].getLanes()[-1 if rng.random() < 0.3 else _first_driving(edges[b])]
            where = str(round(edges[b].getLength() * 0.6, 1))
            ET.SubElement(trip, "stop", lane=lane.getID(), endPos=where, duration=f"{rng.uniform(8, 25):.0f}")
    path = net.with_suffix(".rou.xml")
    ET.ElementTree(root).write(path)
    return path


def _first_driving(edge: Any) -> int:
    return next(k for k, lane in enumerate(edge.getLanes()) if lane.allows("passenger"))


def _run(libsumo: Any, net: Path, trips: Path, seconds: float, seed: int) -> list[Track]:
    options = ["-n", net, "-r", trips, "--step-length", _STEP, "--seed", seed, "--lanechange.duration", "2.5"]
    options += ["--no-warnings", "--no-step-log", "--ignore-route-errors", "--time-to-teleport", "-1"]
    options += ["--pedestrian.model", "striping"]
    libsumo.start(["sumo", *map(str, options)])
    seen: dict[str, tuple[int, float, int, float, float, list[tuple[float, float]]]] = {}
    every, samples = round(INTERVAL / _STEP), round(seconds / INTERVAL) + 1
    try:
        for _ in range(round(_WARM_UP / _STEP)):
            libsumo.simulationStep()
        for k in range(samples):
            for name in libsumo.vehicle.getIDList():
                if name not in seen:
                    kind = _TYPES[int(libsumo.vehicle.getTypeID(name)[1:].split("@")[0])]
                    angle = libsumo.vehicle.getAngle(name)
                    seen[name] = (k, angle, KINDS.index(kind[1]), kind[3], kind[4], [])
                seen[name][5].append(libsumo.vehicle.getPosition(name))
            for name in libsumo.person.getIDList():
                if name not in seen:
                    seen[name] = (k, libsumo.person.getAngle(name), KINDS.index("person"), 0.5, 0.6, [])
                seen[name][5].append(libsumo.person.getPosition(name))
            for _ in range(every):
                libsumo.simulationStep()
    finally:
        libsumo.close()
    return [
        Track(kind, length, width, start, float(np.pi / 2 - np.radians(angle)), np.array(places))
        for start, angle, kind, length, width, places in seen.values()
        if len(places) >= 4
    ]


def _geometry(sumolib: Any, net: Path) -> tuple[list[tuple[int, float, np.ndarray]], list[np.ndarray]]:
    """Lanes as (kind, width, centre line) and the junctions' outlines."""
    network = sumolib.net.readNet(str(net), withInternal=True)
    lanes = []
    for edge in network.getEdges(withInternal=True):
        for lane in edge.getLanes():
            shape = np.array([p[:2] for p in lane.getShape()])
            lanes.append((_lane_kind(edge, lane), lane.getWidth(), shape))
    outlines = [np.array([p[:2] for p in n.getShape()]) for n in network.getNodes()]
    return lanes, [o for o in outlines if len(o) > 2]


def _lane_kind(edge: Any, lane: Any) -> int:
    function = edge.getFunction()
    if function in ("crossing", "walkingarea"):
        return LANES.index(function)
    if function == "internal":
        return LANES.index("junction")
    if lane.allows("passenger"):
        return LANES.index("driving")
    if lane.allows("bicycle"):
        return LANES.index("cycleway")
    return LANES.index("sidewalk" if lane.allows("pedestrian") else "parking")
