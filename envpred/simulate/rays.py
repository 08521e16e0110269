"""Meshes that rays are cast at, by Embree, and what the rays meet."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore import EmbreeDevice
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from envpred.compiled import njit
from envpred.simulate.mesh import Mesh


class Target:
    """A mesh that rays can be cast at."""

    def __init__(self, mesh: Mesh, device: EmbreeDevice) -> None:
        self.mesh = mesh
        self._scene = EmbreeScene(device=device, robust=False)
        TriangleMesh(self._scene, np.ascontiguousarray(mesh.vertices), np.ascontiguousarray(mesh.faces))
        instance: NDArray[np.uint32] = mesh.instance.astype(np.uint32)
        self.word: NDArray[np.uint32] = mesh.label | (instance << np.uint32(16))

    def hit(self, start: NDArray[np.float32], rays: NDArray[np.float32]) -> dict[str, NDArray[Any]]:
        """First hits of rays (N, 3) from `start` (3,) or (N, 3): tfar (N,) m, primID (N,) face or -1, Ng normals."""
        starts = np.ascontiguousarray(np.broadcast_to(start, rays.shape))
        hits: dict[str, NDArray[Any]] = self._scene.run(starts, rays, output=True)
        return hits


@dataclass
class Struck:
    """What rays (N,) meet first: distance (inf: nothing), label word, material, cosine of the angle of incidence."""

    distance: NDArray[np.float32]
    word: NDArray[np.uint32]
    material: NDArray[np.uint8]
    cosine: NDArray[np.float32]

    def of(self, rays: NDArray[Any]) -> "Struck":
        """That of some of the rays, by number or mask."""
        return Struck(self.distance[rays], self.word[rays], self.material[rays], self.cosine[rays])

    def put(self, rays: NDArray[Any], other: "Struck") -> None:
        """Replaces that of some of the rays by `other`'s."""
        self.distance[rays], self.word[rays] = other.distance, other.word
        self.material[rays], self.cosine[rays] = other.material, other.cosine


def strike(target: Target, start: NDArray[np.float32], rays: NDArray[np.float32]) -> Struck:
    """The first of `target` that rays (N, 3) from `start` (N, 3) meet."""
    hits = target.hit(start, rays)
    face, distance = hits["primID"].astype(np.intp), hits["tfar"]
    distance[face < 0] = np.inf
    return Struck(distance, target.word.take(face), target.mesh.material.take(face), incidence(hits["Ng"], rays))


@njit(nogil=True)
def incidence(normal, rays):  # type: ignore[no-untyped-def]
    """Cosines (N,) of the angles between rays (N, 3), of length 1, and faces whose normals (N, 3) have any length."""
    cosine = np.empty(len(normal), np.float32)
    for n in range(len(normal)):
        x, y, z = normal[n]
        length = max(np.sqrt(x * x + y * y + z * z), np.float32(1e-12))
        cosine[n] = abs(x * rays[n, 0] + y * rays[n, 1] + z * rays[n, 2]) / length
    return cosine
