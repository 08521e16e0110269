"""What stands along a street: trees, hedges, walls, poles, houses.

Every model stands on z = 0 around the origin; lengths run along x, in metres.
"""

import numpy as np

from envpred.simulate import classes
from envpred.simulate.mesh import FloatArray, Mesh, box, column, join, leaves, mesh, prism


def tree(height: float, radius: float, bare: float, rng: np.random.Generator) -> Mesh:
    """A trunk free of leaves up to `bare` metres under an ellipsoid crown of loose leaves."""
    n = int(160 * radius**2)
    direction = rng.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    reach = rng.uniform(0.25, 1.0, (n, 1)) ** (1 / 3) * (
        1 + 0.15 * np.sin(3 * direction[:, :1] + 2 * direction[:, 1:2])
    )
    half = (height - bare) / 2
    crown = direction * reach * [radius, radius, half] + [0, 0, bare + half]
    thick = 0.09 + 0.025 * height / 2
    return join(
        [
            column(thick, (-0.3, bare + half), classes.TRUNK, "bark", top=0.6 * thick),
            leaves(crown, 0.26, classes.VEGETATION, rng),
        ]
    )


def bush(radius: float, height: float, rng: np.random.Generator) -> Mesh:
    """A round bush that starts at the ground."""
    n = int(170 * radius * max(radius, 0.5))
    angle, reach = rng.uniform(0, 2 * np.pi, n), radius * np.sqrt(rng.uniform(0.2, 1, n))
    z = rng.uniform(0, 1, n) * height * np.sqrt(np.maximum(0, 1.05 - (reach / radius) ** 2))
    return leaves(np.column_stack([reach * np.cos(angle), reach * np.sin(angle), z]), 0.2, classes.VEGETATION, rng)


def hedge(length: float, width: float, height: float, rng: np.random.Generator) -> Mesh:
    """A cut hedge: a core that stops light, leaves around it."""
    n = int(20 * length * (width + 2 * height))
    face = rng.uniform(0, width + 2 * height, n)
    y = np.where(face < width, face - width / 2, np.where(face < width + height, -width / 2, width / 2))
    z = np.where(face < width, height, (face - width) % height)
    places = np.column_stack([rng.uniform(-length / 2, length / 2, n), y, z]) + rng.normal(0, 0.05, (n, 3))
    core = box((-length / 2, length / 2), (-0.05, 0.05), (-0.5, height - 0.1), classes.VEGETATION, "twigs")
    return join([core, leaves(places, 0.16, classes.VEGETATION, rng)])


def wall(length: float, height: float) -> Mesh:
    """A garden wall."""
    return box((-length / 2, length / 2), (-0.12, 0.12), (-0.8, height), classes.FENCE, "brick")


def fence(length: float, height: float) -> Mesh:
    """Posts and pales with gaps: about half of the light goes through."""
    x = np.arange(-length / 2, length / 2, 0.16)
    parts = [box((a, a + 0.08), (-0.015, 0.015), (0.08, height), classes.FENCE, "wood") for a in x]
    rails = [
        box((-length / 2, length / 2), (0.02, 0.05), (h, h + 0.08), classes.FENCE, "wood")
        for h in (0.25, height - 0.25)
    ]
    posts = [box((a, a + 0.1), (-0.05, 0.05), (-0.5, height), classes.FENCE, "wood") for a in x[::15]]
    return join(parts + rails + posts)


def pole(height: float, radius: float = 0.07) -> Mesh:
    """A lamp post."""
    lamp = box((0.0, 0.9), (-0.12, 0.12), (height - 0.12, height), classes.POLE, "metal")
    return join([column(radius, (-0.3, height), classes.POLE, "metal", sides=6, top=0.7 * radius), lamp])


def sign(height: float) -> Mesh:
    """A traffic sign that faces along x."""
    plate = box((-0.02, 0.02), (-0.32, 0.32), (height - 0.65, height), classes.TRAFFIC_SIGN, "sign")
    return join([column(0.035, (-0.3, height - 0.3), classes.POLE, "metal", sides=6), plate])


def bin_box(length: float, width: float, height: float) -> Mesh:
    """A dustbin, an electricity cabinet, a bench's bulk."""
    return box((-length / 2, length / 2), (-width / 2, width / 2), (-0.2, height), classes.OTHER_OBJECT, "metal")


def house(length: float, depth: float, height: float, roof: float, rng: np.random.Generator) -> Mesh:
    """A house along x with rows of windows, a door niche, a ridge roof (none if `roof` is 0) and eaves."""
    material = str(rng.choice(["plaster", "brick"]))
    half, back = length / 2, depth / 2
    parts = [box((-half, half), (-back, back), (-2.0, height), classes.BUILDING, material)]
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
        parts.append(box((x - w, x + w), (-back - out, -back), (low, max(top, low + 0.3)), classes.BUILDING, material))
    return join(parts)


def _along_x(outline: FloatArray, half: float) -> Mesh:
    """An outline in y and z, extruded along x."""
    roof = prism(outline, (-half - 0.2, half + 0.2), classes.BUILDING, "brick")
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
    faces = np.concatenate([first + np.array([0, 1, 2]), first + np.array([0, 2, 3])])
    return mesh(corner.reshape(-1, 3), faces, classes.BUILDING, "window")
