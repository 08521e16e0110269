"""What stands and moves in a street: vehicles, people, bicycles, trees, hedges, walls, poles, houses.

Every model stands on z = 0 around the origin, x forward; `size` is length, width, height in metres.
"""

from functools import lru_cache

import numpy as np

from envpred.drives.simulate import labels as L
from envpred.drives.simulate.mesh import FloatArray, Mesh, box, column, frustum, join, leaves, mesh, prism, wheel
from envpred.drives.simulate.traffic import KINDS

# Height of each kind of road user in metres (cars vary with their length).
_HEIGHT = {"van": 2.25, "truck": 3.2, "bicycle": 1.75, "person": 1.75}
_CLASS = {"car": L.CAR, "van": L.CAR, "truck": L.TRUCK, "bicycle": L.BICYCLIST, "person": L.PERSON}
PHASES = 4  # postures of a stride


def road_user(kind: int, length: float, width: float, light: bool = True, phase: int = 0) -> Mesh:
    """The model of a road user of `traffic.KINDS[kind]`; `phase` is a walker's posture."""
    return _road_user(KINDS[kind], round(length, 2), round(width, 2), light, phase % PHASES)


@lru_cache(maxsize=256)
def size_of(kind: int, length: float, width: float) -> tuple[float, float, float]:
    """Length, width, height in metres of a road user's box, whatever its posture."""
    vertices = np.concatenate([road_user(kind, length, width, phase=phase).vertices for phase in range(PHASES)])
    along, across, up = np.abs(vertices).max(axis=0)
    return float(2 * along), float(2 * across), float(up)


def class_of(kind: int, moving: bool) -> int:
    """SemanticKITTI's class number of a road user."""
    still = _CLASS[KINDS[kind]]
    return L.MOVING_OF[still] if moving else still


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
    base: tuple[float, float, float, float], roof: tuple[float, float, float, float], z: tuple[float, float], label: int, paint: str
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
    return [*front, box((-0.29 * length, -0.29 * length + 0.2), (-width / 2 + 0.25, width / 2 - 0.25), (0.7, 1.15), label, "cloth")]


def _car(length: float, width: float, height: float, paint: str) -> Mesh:
    """Body with bonnet and boot, tapered cabin of glass under a roof, four wheels."""
    half, w = length / 2, width / 2
    hull = np.array([(-half, 0.35), (-half + 0.12, 0.22), (half - 0.15, 0.22), (half, 0.38), (half - 0.04, 0.66),
                     (half - 0.9, 0.90), (-half + 0.15, 0.95), (-half + 0.02, 0.70)])
    base = (-half + 0.25, half - 1.05, -w + 0.06, w - 0.06)
    roof = (-half + 0.75, half - 1.95, -w + 0.22, w - 0.22)
    return join([
        prism(hull, (-w + 0.02, w - 0.02), L.CAR, paint),
        *_pillars(base, roof, (0.88, height - 0.06), L.CAR, paint),
        frustum(roof, roof, (height - 0.06, height), L.CAR, paint),
        *_seats(length, width, L.CAR),
        *_wheels(length, width, 0.31, L.CAR),
    ])


def _van(length: float, width: float, height: float, paint: str) -> Mesh:
    half, w = length / 2, width / 2
    hull = np.array([(-half, 0.25), (half - 0.1, 0.25), (half, 0.45), (half - 0.05, 0.85), (half - 0.7, 1.15),
                     (half - 1.35, height), (-half, height)])
    glass = frustum((half - 1.9, half - 1.0, -w - 0.005, w + 0.005), (half - 1.9, half - 1.3, -w - 0.005, w + 0.005),
                    (1.2, 1.8), L.CAR, "window")
    return join([prism(hull, (-w, w), L.CAR, paint), glass, *_wheels(length, width, 0.34, L.CAR)])


def _truck(length: float, width: float, height: float, paint: str) -> Mesh:
    half, w = length / 2, width / 2
    return join([
        box((half - 1.9, half), (-w, w), (0.45, 2.6), L.TRUCK, paint),
        box((-half, half - 2.1), (-w, w), (0.95, height), L.TRUCK, "metal"),
        box((-half, half), (-0.5, 0.5), (0.55, 0.95), L.TRUCK, "metal"),
        *_wheels(length, width, 0.48, L.TRUCK),
    ])


def _person(phase: int) -> Mesh:
    """Legs (apart by the phase of the stride), trunk, arms, head."""
    stride = 0.28 * np.sin(phase * np.pi / 2)
    parts = []
    for side, swing in ((0.1, stride), (-0.1, -stride)):
        foot, hip = (swing - 0.08, swing + 0.1, side - 0.07, side + 0.07), (-0.08, 0.08, side - 0.08, side + 0.08)
        parts.append(frustum(foot, hip, (0.0, 0.85), L.PERSON, "cloth"))
        arm, shoulder = -swing * 0.8, side * 2.3
        hand = (arm - 0.05, arm + 0.05, shoulder - 0.05, shoulder + 0.05)
        parts.append(frustum(hand, (-0.06, 0.06, *hand[2:]), (0.8, 1.4), L.PERSON, "cloth"))
    parts.append(column(0.15, (0.82, 1.48), L.PERSON, "cloth", sides=8, top=0.19))
    parts.append(column(0.10, (1.50, 1.75), L.PERSON, "cloth", sides=6, top=0.08))
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
        body.append(frustum(foot, (-0.22, -0.02, side - 0.08, side + 0.08), (0.3 + up, 1.0), L.BICYCLIST, "cloth"))
    trunk = frustum((-0.27, 0.0, -0.18, 0.18), (0.02, 0.26, -0.21, 0.21), (0.93, 1.5), L.BICYCLIST, "cloth")
    arms = frustum((0.36, 0.46, -0.26, 0.26), (0.1, 0.22, -0.24, 0.24), (1.02, 1.4), L.BICYCLIST, "cloth")
    head = column(0.10, (1.5, 1.75), L.BICYCLIST, "cloth", sides=6)
    return join([*_bicycle(length, L.BICYCLIST), *body, trunk, arms, head.at(0.2, 0.0, 0.0)])


def parked_bicycle() -> Mesh:
    """A bicycle without a rider."""
    return join(_bicycle(1.75, L.BICYCLE))


def tree(height: float, radius: float, bare: float, rng: np.random.Generator) -> Mesh:
    """A trunk free of leaves up to `bare` metres under an ellipsoid crown of loose leaves."""
    n = int(160 * radius**2)
    direction = rng.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    reach = rng.uniform(0.25, 1.0, (n, 1)) ** (1 / 3) * (1 + 0.15 * np.sin(3 * direction[:, :1] + 2 * direction[:, 1:2]))
    half = (height - bare) / 2
    crown = direction * reach * [radius, radius, half] + [0, 0, bare + half]
    thick = 0.09 + 0.025 * height / 2
    return join([column(thick, (-0.3, bare + half), L.TRUNK, "bark", top=0.6 * thick), leaves(crown, 0.26, L.VEGETATION, rng)])


def bush(radius: float, height: float, rng: np.random.Generator) -> Mesh:
    """A round bush that starts at the ground."""
    n = int(170 * radius * max(radius, 0.5))
    angle, reach = rng.uniform(0, 2 * np.pi, n), radius * np.sqrt(rng.uniform(0.2, 1, n))
    z = rng.uniform(0, 1, n) * height * np.sqrt(np.maximum(0, 1.05 - (reach / radius) ** 2))
    return leaves(np.column_stack([reach * np.cos(angle), reach * np.sin(angle), z]), 0.2, L.VEGETATION, rng)


def hedge(length: float, width: float, height: float, rng: np.random.Generator) -> Mesh:
    """A cut hedge: a core that stops light, leaves around it."""
    n = int(20 * length * (width + 2 * height))
    face = rng.uniform(0, width + 2 * height, n)
    y = np.where(face < width, face - width / 2, np.where(face < width + height, -width / 2, width / 2))
    z = np.where(face < width, height, (face - width) % height)
    places = np.column_stack([rng.uniform(-length / 2, length / 2, n), y, z]) + rng.normal(0, 0.05, (n, 3))
    core = box((-length / 2, length / 2), (-0.05, 0.05), (-0.5, height - 0.1), L.VEGETATION, "leaves")
    return join([core, leaves(places, 0.16, L.VEGETATION, rng)])


def wall(length: float, height: float) -> Mesh:
    """A garden wall."""
    return box((-length / 2, length / 2), (-0.12, 0.12), (-0.8, height), L.FENCE, "brick")


def fence(length: float, height: float) -> Mesh:
    """Posts and pales with gaps: about half of the light goes through."""
    x = np.arange(-length / 2, length / 2, 0.16)
    parts = [box((a, a + 0.08), (-0.015, 0.015), (0.08, height), L.FENCE, "wood") for a in x]
    rails = [box((-length / 2, length / 2), (0.02, 0.05), (h, h + 0.08), L.FENCE, "wood") for h in (0.25, height - 0.25)]
    posts = [box((a, a + 0.1), (-0.05, 0.05), (-0.5, height), L.FENCE, "wood") for a in x[::15]]
    return join(parts + rails + posts)


def pole(height: float, radius: float = 0.07) -> Mesh:
    """A lamp post."""
    lamp = box((0.0, 0.9), (-0.12, 0.12), (height - 0.12, height), L.POLE, "metal")
    return join([column(radius, (-0.3, height), L.POLE, "metal", sides=6, top=0.7 * radius), lamp])


def sign(height: float) -> Mesh:
    """A traffic sign that faces along x."""
    plate = box((-0.02, 0.02), (-0.32, 0.32), (height - 0.65, height), L.TRAFFIC_SIGN, "sign")
    return join([column(0.035, (-0.3, height - 0.3), L.POLE, "metal", sides=6), plate])


def bin_box(length: float, width: float, height: float) -> Mesh:
    """A dustbin, an electricity cabinet, a bench's bulk."""
    return box((-length / 2, length / 2), (-width / 2, width / 2), (-0.2, height), L.OTHER_OBJECT, "metal")


def house(length: float, depth: float, height: float, roof: float, rng: np.random.Generator) -> Mesh:
    """A house along x with rows of windows, a door niche, a ridge roof (none if `roof` is 0) and eaves."""
    material = str(rng.choice(["plaster", "brick"]))
    half, back = length / 2, depth / 2
    parts = [box((-half, half), (-back, back), (-2.0, height), L.BUILDING, material)]
    if roof:
        gable = np.array([(-back - 0.4, height), (back + 0.4, height), (0.0, height + roof)])
        parts.append(_along_x(gable, half))
    panes = _windows(length, height, rng)
    for side in (-back - 0.015, back + 0.015):
        parts.append(_panes(panes, side))
    for _ in range(rng.poisson(length / 6)):  # oriels, porches and steps break the flat front
        x, w, out = rng.uniform(-half + 1, half - 1), rng.uniform(0.5, 1.3), rng.uniform(0.4, 1.1)
        low = rng.choice([-0.5, 2.6])
        top = min(low + rng.choice([0.9, 3.0]), height)
        parts.append(box((x - w, x + w), (-back - out, -back), (low, max(top, low + 0.3)), L.BUILDING, material))
    return join(parts)


def _along_x(outline: FloatArray, half: float) -> Mesh:
    """An outline in y and z, extruded along x."""
    roof = prism(outline, (-half - 0.2, half + 0.2), L.BUILDING, "brick")
    return Mesh(roof.vertices[:, [1, 0, 2]], roof.faces, roof.label, roof.instance, roof.material)


def _windows(length: float, height: float, rng: np.random.Generator) -> FloatArray:
    """Left edge, right edge, sill, lintel of the windows of a front: (n, 4)."""
    step = rng.uniform(2.0, 3.2)
    x = np.arange(-length / 2 + 0.8, length / 2 - 1.6, step)
    z = np.arange(1.0, height - 1.6, 2.9)
    left, sill = (v.ravel() for v in np.meshgrid(x, z, indexing="ij"))
    return np.column_stack([left, left + 0.5 * step, sill, sill + 1.4])


def _panes(windows: FloatArray, y: float) -> Mesh:
    n = len(windows)
    corner = np.stack([windows[:, [0, 0, 1, 1]], np.full((n, 4), y), windows[:, [2, 3, 3, 2]]], axis=-1)
    first = 4 * np.arange(n)[:, None]
    faces = np.concatenate([first + [0, 1, 2], first + [0, 2, 3]])
    return mesh(corner.reshape(-1, 3), faces, L.BUILDING, "window")
