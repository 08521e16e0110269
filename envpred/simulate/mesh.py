"""Triangle meshes whose faces know their class and material, and the solids that everything here is made of."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

# Material: (reflectance at normal incidence, share of the returns that is lost).
MATERIALS = {
    "asphalt": (0.18, 0.0),
    "paving": (0.30, 0.0),
    "grass": (0.40, 0.01),
    "plaster": (0.55, 0.0),
    "brick": (0.35, 0.0),
    "window": (0.10, 0.75),
    "leaves": (0.45, 0.03),
    "twigs": (0.40, 0.02),
    "bark": (0.30, 0.0),
    "wood": (0.40, 0.0),
    "paint_dark": (0.12, 0.04),
    "paint_light": (0.60, 0.01),
    "rubber": (0.06, 0.05),
    "metal": (0.50, 0.0),
    "sign": (0.95, 0.0),
    "cloth": (0.35, 0.01),
    "spokes": (0.30, 0.65),
}
MATERIAL = {name: k for k, name in enumerate(MATERIALS)}


@dataclass(frozen=True)
class Mesh:
    """Triangles: `vertices` (V, 3) metres, `faces` (F, 3), and for every face a class, an instance and a material."""

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    label: NDArray[np.uint16]
    instance: NDArray[np.uint16]
    material: NDArray[np.uint8]

    def at(self, x: float, y: float, z: float, heading: float = 0.0, instance: int = 0) -> "Mesh":
        """This mesh turned by `heading` about z and moved to (x, y, z), as object number `instance`."""
        c, s = np.cos(heading), np.sin(heading)
        rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]], np.float32)
        vertices = self.vertices @ rotation.T + np.array([x, y, z], np.float32)
        return Mesh(vertices, self.faces, self.label, np.full_like(self.instance, instance), self.material)

    def labelled(self, label: int) -> "Mesh":
        """This mesh as of one class."""
        return Mesh(self.vertices, self.faces, np.full_like(self.label, label), self.instance, self.material)


def mesh(vertices: ArrayLike, faces: ArrayLike, label: ArrayLike, material: str | NDArray[np.uint8]) -> Mesh:
    """A mesh without instance; `label` and `material` are for all faces or one each."""
    f = np.asarray(faces, np.int32).reshape(-1, 3)
    kind = MATERIAL[material] if isinstance(material, str) else material
    return Mesh(
        np.asarray(vertices, np.float32).reshape(-1, 3),
        f,
        np.broadcast_to(np.asarray(label, np.uint16), len(f)).copy(),
        np.zeros(len(f), np.uint16),
        np.broadcast_to(np.asarray(kind, np.uint8), len(f)).copy(),
    )


def join(parts: list[Mesh]) -> Mesh:
    """One mesh of all `parts` (at least one)."""
    starts = np.cumsum([0] + [len(p.vertices) for p in parts[:-1]])
    return Mesh(
        np.concatenate([p.vertices for p in parts]),
        np.concatenate([p.faces + s for p, s in zip(parts, starts, strict=True)]).astype(np.int32),
        np.concatenate([p.label for p in parts]),
        np.concatenate([p.instance for p in parts]),
        np.concatenate([p.material for p in parts]),
    )


_QUADS = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
_BOX_FACES = np.concatenate([_QUADS[:, [0, 1, 2]], _QUADS[:, [0, 2, 3]]])


def frustum(
    lower: tuple[float, float, float, float],
    upper: tuple[float, float, float, float],
    z: tuple[float, float],
    label: int,
    material: str,
) -> Mesh:
    """A solid between two rectangles (x0, x1, y0, y1) at the heights `z`; equal rectangles give a box."""
    corners = [(r[i], r[2 + j], h) for i in (0, 1) for j in (0, 1) for r, h in ((lower, z[0]), (upper, z[1]))]
    return mesh(corners, _BOX_FACES, label, material)


def box(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float], label: int, material: str) -> Mesh:
    """An upright box between the given limits."""
    return frustum((*x, *y), (*x, *y), z, label, material)


def prism(outline: FloatArray, y: tuple[float, float], label: int, material: str) -> Mesh:
    """A convex `outline` (n, 2) in x and z, extruded along y between the limits `y`."""
    n = len(outline)
    left, right = (np.column_stack([outline[:, 0], np.full(n, v), outline[:, 1]]) for v in y)
    ring = np.arange(n)
    after = np.roll(ring, -1)
    fan = np.stack([np.zeros(n - 2, int), ring[1:-1], ring[2:]], axis=1)
    sides = [np.stack([ring, after, after + n], axis=1), np.stack([ring, after + n, ring + n], axis=1)]
    return mesh(np.concatenate([left, right]), np.concatenate([fan, fan + n, *sides]), label, material)


def column(
    radius: float, z: tuple[float, float], label: int, material: str, sides: int = 8, top: float | None = None
) -> Mesh:
    """An upright round column (a cone if `top`, its upper radius, differs) around the origin."""
    angle = np.arange(sides) * 2 * np.pi / sides
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rings = [np.column_stack([r * circle, np.full(sides, h)]) for r, h in zip((radius, top or radius), z, strict=True)]
    k = np.arange(sides)
    after = np.roll(k, -1)
    cap = np.stack([np.full(sides - 2, sides), k[1:-1] + sides, k[2:] + sides], axis=1)
    faces = [np.stack([k, after, after + sides], axis=1), np.stack([k, after + sides, k + sides], axis=1), cap]
    return mesh(np.concatenate(rings), np.concatenate(faces), label, material)


def wheel(x: float, y: tuple[float, float], radius: float, label: int, material: str, sides: int = 10) -> Mesh:
    """A wheel that stands on the ground at `x`, its axle along y."""
    angle = np.arange(sides) * 2 * np.pi / sides
    outline = np.column_stack([x + radius * np.cos(angle), radius + radius * np.sin(angle)])
    return prism(outline, y, label, material)


def leaves(centres: FloatArray, size: float, label: int, rng: np.random.Generator) -> Mesh:
    """A loose cloud of triangles, about `size` metres wide, around the `centres` (n, 3); light falls through it."""
    corners = centres[:, None, :] + rng.normal(0, size / 2, (len(centres), 3, 3))
    return mesh(corners.reshape(-1, 3), np.arange(3 * len(centres)), label, "leaves")
