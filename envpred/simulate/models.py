"""Who moves in a street, or parks there: vehicles, people, bicycles.

Every model stands on z = 0 around the origin, x forward, in metres.
"""

from functools import lru_cache

import numpy as np

from envpred.simulate import classes
from envpred.simulate.mesh import Mesh, box, column, frustum, join, prism, wheel
from envpred.simulate.traffic import KINDS

# Height of each kind of road user in metres (cars vary with their length).
_HEIGHT = {"van": 2.25, "truck": 3.2, "bicycle": 1.75, "person": 1.75}
_CLASS = {
    "car": classes.CAR,
    "van": classes.CAR,
    "truck": classes.TRUCK,
    "bicycle": classes.BICYCLIST,
    "person": classes.PERSON,
}
PHASES = 4  # postures of a stride
_STRIDES = {"bicycle", "person"}


def road_user(kind: int, length: float, width: float, light: bool = True, phase: int = 0) -> Mesh:
    """The model of a road user of `traffic.KINDS[kind]`; `phase` is a walker's posture."""
    posture = phase % PHASES if KINDS[kind] in _STRIDES else 0
    return _road_user(KINDS[kind], round(length, 2), round(width, 2), light, posture)


@lru_cache(maxsize=256)
def size_of(kind: int, length: float, width: float) -> tuple[float, float, float]:
    """Length, width, height in metres of a road user's box, whatever its posture."""
    vertices = np.concatenate([road_user(kind, length, width, phase=phase).vertices for phase in range(PHASES)])
    along, across, up = np.abs(vertices).max(axis=0)
    return float(2 * along), float(2 * across), float(up)


def class_of(kind: int, moving: bool) -> int:
    """SemanticKITTI's class number of a road user."""
    still = _CLASS[KINDS[kind]]
    return classes.MOVING_OF[still] if moving else still


@lru_cache(maxsize=256)
def _road_user(kind: str, length: float, width: float, light: bool, phase: int) -> Mesh:
    paint = "paint_light" if light else "paint_dark"
    if kind == "person":
        return _person(phase)
    if kind == "bicycle":
        return _bicyclist(length, phase)
    if kind == "truck":
        return _truck(length, width, _HEIGHT[kind], paint)
    if kind == "van":
        return _van(length, width, _HEIGHT[kind], paint)
    return _car(length, width, 1.42 + 0.02 * (length > 4.5) + 0.08 * (length < 4.0), paint)


def _wheels(length: float, width: float, radius: float, label: int) -> list[Mesh]:
    axles = (0.31 * length, -0.29 * length)
    sides = ((-width / 2, -width / 2 + 0.2), (width / 2 - 0.2, width / 2))
    return [wheel(x, y, radius, label, "rubber") for x in axles for y in sides]


def _pillars(
    base: tuple[float, float, float, float],
    roof: tuple[float, float, float, float],
    z: tuple[float, float],
    label: int,
    paint: str,
) -> list[Mesh]:
    """What holds a roof at its corners and between the doors; the glass around it lets the light through."""
    pillars = []
    for share in (0.0, 0.5, 1.0):
        for side in (2, 3):
            lower, upper = ((1 - share) * r[0] + share * r[1] for r in (base, roof))
            thick = 0.06
            foot, head = (
                (x - thick, x + thick, y - 0.04, y + 0.04) for x, y in ((lower, base[side]), (upper, roof[side]))
            )
            pillars.append(frustum(foot, head, z, label, paint))
    return pillars


def _seats(length: float, width: float, label: int) -> list[Mesh]:
    """Backs of front and rear seats, seen through the glass."""
    front = [box((-0.35, -0.15), (y - 0.22, y + 0.22), (0.7, 1.25), label, "cloth") for y in (-0.37, 0.37)]
    return [
        *front,
        box((-0.29 * length, -0.29 * length + 0.2), (-width / 2 + 0.25, width / 2 - 0.25), (0.7, 1.15), label, "cloth"),
    ]


def _car(length: float, width: float, height: float, paint: str) -> Mesh:
    """Body with bonnet and boot, tapered cabin of glass under a roof, four wheels."""
    half, w = length / 2, width / 2
    hull = np.array(
        [
            (-half, 0.35),
            (-half + 0.12, 0.22),
            (half - 0.15, 0.22),
            (half, 0.38),
            (half - 0.04, 0.66),
            (half - 0.9, 0.90),
            (-half + 0.15, 0.95),
            (-half + 0.02, 0.70),
        ]
    )
    base = (-half + 0.25, half - 1.05, -w + 0.06, w - 0.06)
    roof = (-half + 0.75, half - 1.95, -w + 0.22, w - 0.22)
    return join(
        [
            prism(hull, (-w + 0.02, w - 0.02), classes.CAR, paint),
            *_pillars(base, roof, (0.88, height - 0.06), classes.CAR, paint),
            frustum(roof, roof, (height - 0.06, height), classes.CAR, paint),
            *_seats(length, width, classes.CAR),
            *_wheels(length, width, 0.31, classes.CAR),
        ]
    )


def _van(length: float, width: float, height: float, paint: str) -> Mesh:
    half, w = length / 2, width / 2
    hull = np.array(
        [
            (-half, 0.25),
            (half - 0.1, 0.25),
            (half, 0.45),
            (half - 0.05, 0.85),
            (half - 0.7, 1.15),
            (half - 1.35, height),
            (-half, height),
        ]
    )
    glass = frustum(
        (half - 1.9, half - 1.0, -w - 0.005, w + 0.005),
        (half - 1.9, half - 1.3, -w - 0.005, w + 0.005),
        (1.2, 1.8),
        classes.CAR,
        "window",
    )
    return join([prism(hull, (-w, w), classes.CAR, paint), glass, *_wheels(length, width, 0.34, classes.CAR)])


def _truck(length: float, width: float, height: float, paint: str) -> Mesh:
    half, w = length / 2, width / 2
    return join(
        [
            box((half - 1.9, half), (-w, w), (0.45, 2.6), classes.TRUCK, paint),
            box((-half, half - 2.1), (-w, w), (0.95, height), classes.TRUCK, "metal"),
            box((-half, half), (-0.5, 0.5), (0.55, 0.95), classes.TRUCK, "metal"),
            *_wheels(length, width, 0.48, classes.TRUCK),
        ]
    )


def _person(phase: int) -> Mesh:
    """Legs (apart by the phase of the stride), trunk, arms, head."""
    stride = 0.28 * np.sin(phase * np.pi / 2)
    parts = []
    for side, swing in ((0.1, stride), (-0.1, -stride)):
        foot, hip = (swing - 0.08, swing + 0.1, side - 0.07, side + 0.07), (-0.08, 0.08, side - 0.08, side + 0.08)
        parts.append(frustum(foot, hip, (0.0, 0.85), classes.PERSON, "cloth"))
        arm, shoulder = -swing * 0.8, side * 2.3
        hand = (arm - 0.05, arm + 0.05, shoulder - 0.05, shoulder + 0.05)
        parts.append(frustum(hand, (-0.06, 0.06, *hand[2:]), (0.8, 1.4), classes.PERSON, "cloth"))
    parts.append(column(0.15, (0.82, 1.48), classes.PERSON, "cloth", sides=8, top=0.19))
    parts.append(column(0.10, (1.50, 1.75), classes.PERSON, "cloth", sides=6, top=0.08))
    return join(parts)


def _bicycle(length: float, label: int) -> list[Mesh]:
    reach = length / 2 - 0.34
    return [
        wheel(reach, (-0.02, 0.02), 0.34, label, "spokes", sides=12),
        wheel(-reach, (-0.02, 0.02), 0.34, label, "spokes", sides=12),
        box((-reach, reach - 0.1), (-0.025, 0.025), (0.5, 0.58), label, "metal"),
        box((reach - 0.16, reach - 0.06), (-0.025, 0.025), (0.34, 1.0), label, "metal"),
        box((reach - 0.2, reach - 0.1), (-0.28, 0.28), (0.98, 1.04), label, "metal"),
        box((-0.3, -0.05), (-0.08, 0.08), (0.9, 0.97), label, "rubber"),
    ]


def _bicyclist(length: float, phase: int) -> Mesh:
    lift = 0.12 * np.sin(phase * np.pi / 2)
    body = []
    for side, up in ((0.11, lift), (-0.11, -lift)):
        foot = (0.02, 0.2, side - 0.06, side + 0.06)
        body.append(
            frustum(foot, (-0.22, -0.02, side - 0.08, side + 0.08), (0.3 + up, 1.0), classes.BICYCLIST, "cloth")
        )
    trunk = frustum((-0.27, 0.0, -0.18, 0.18), (0.02, 0.26, -0.21, 0.21), (0.93, 1.5), classes.BICYCLIST, "cloth")
    arms = frustum((0.36, 0.46, -0.26, 0.26), (0.1, 0.22, -0.24, 0.24), (1.02, 1.4), classes.BICYCLIST, "cloth")
    head = column(0.10, (1.5, 1.75), classes.BICYCLIST, "cloth", sides=6)
    return join([*_bicycle(length, classes.BICYCLIST), *body, trunk, arms, head.at(0.2, 0.0, 0.0)])


def parked_bicycle() -> Mesh:
    """A bicycle without a rider."""
    return join(_bicycle(1.75, classes.BICYCLE))
