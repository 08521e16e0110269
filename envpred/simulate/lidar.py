"""A Velodyne HDL-64E at 10 Hz on the roof of KITTI's car: rays by Embree, ranges, intensities and losses of our own.

Scanners of 16, 32 and 128 beams stand beside it (`SENSORS`).  The sweep is frozen: all rays of a scan leave from the
pose at its middle, so the ego's motion during the 0.1 s of a turn bends nothing, unless each firing has a pose.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore import EmbreeDevice
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from envpred.simulate.mesh import MATERIALS, FloatArray, Mesh

_REFLECTANCE, _LOST = np.array(list(MATERIALS.values()), np.float32).T


class Target:
    """A mesh that rays can be cast at."""

    def __init__(self, mesh: Mesh, device: EmbreeDevice) -> None:
        self.mesh = mesh
        self._scene = EmbreeScene(device=device)
        TriangleMesh(self._scene, np.ascontiguousarray(mesh.vertices), np.ascontiguousarray(mesh.faces))
        instance: NDArray[np.uint32] = mesh.instance.astype(np.uint32)
        self.word: NDArray[np.uint32] = mesh.label | (instance << np.uint32(16))

    def hit(self, origin: NDArray[np.float32], directions: NDArray[np.float32]) -> dict[str, NDArray[Any]]:
        """First hits of rays (N, 3) from `origin` (3,) or (N, 3): tfar (N,) m, primID (N,) face or -1, Ng normals."""
        starts = np.broadcast_to(origin, directions.shape).copy()
        hits: dict[str, NDArray[Any]] = self._scene.run(starts, directions, output=True)
        return hits


@dataclass(frozen=True)
class HDL64E:
    """The sensor (Velodyne's manual of the HDL-64E S2; what KITTI's car hides of the view is read off its scans).

    Args:
        columns: firings a turn at 10 Hz, 0.173 degrees apart (KITTI turned a little slower: 2152 at 9.68 Hz).
        nearest, farthest: returns nearer or farther (metres) are not recorded; KITTI keeps 80 m.
        noise: standard deviation of a range, metres.
        lost: share of returns that are lost anyhow.
        faint: returned share of the light, at 80 m face on, at which two of three returns are lost.
    """

    columns: int = 2083
    nearest: float = 0.9
    farthest: float = 80.0
    noise: float = 0.018
    lost: float = 0.006
    faint: float = 0.004

    @cached_property
    def elevation(self) -> FloatArray:
        """(64,) radians, top beam first: two blocks of 32 lasers, 1/3 and 1/2 degree apart."""
        upper = 2.0 - np.arange(32) / 3
        lower = -8.83 - np.arange(32) / 2
        angles: FloatArray = np.radians(np.concatenate([upper, lower]))
        return angles

    @cached_property
    def azimuth(self) -> FloatArray:
        """(columns,) radians, counter-clockwise from ahead."""
        return (np.arange(self.columns) + 0.5) * 2 * np.pi / self.columns

    @cached_property
    def directions(self) -> NDArray[np.float32]:
        """Unit vectors (rays, 3) in the sensor frame in the order of KITTI's files: beam by beam from the top."""
        e, a = self.elevation[:, None], self.azimuth[None]
        grid = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e) + 0 * a], axis=-1)
        return grid.reshape(-1, 3)[self._seen].astype(np.float32)

    @cached_property
    def column(self) -> NDArray[np.intp]:
        """Which firing each ray belongs to (rays,)."""
        columns: NDArray[np.intp] = np.tile(np.arange(self.columns), len(self.elevation))[self._seen]
        return columns

    @cached_property
    def _seen(self) -> NDArray[np.bool_]:
        """Rays that the car itself does not stop: its roof behind, its bonnet ahead, a mast at its right."""
        beam = np.arange(64)[:, None]
        degrees = np.degrees(self.azimuth)[None]
        ahead = np.minimum(degrees, 360 - degrees)
        hidden = (np.abs(degrees - 183) < 13 + 1.9 * (beam - 49)) & (beam > 48)
        hidden |= (beam > 45) & (beam < 50) & ((np.abs(degrees - 165) < 4) | (np.abs(degrees - 203) < 5))
        hidden |= (beam > 46) & (beam < 60) & (np.abs(degrees - 290) < 8)
        hidden |= (beam > 54) & ((np.abs(degrees - 135) < 4) | (np.abs(degrees - 234) < 4))
        hidden |= (beam > 58) & (ahead < 10 + 3 * (beam - 59))
        seen: NDArray[np.bool_] = ~hidden.ravel()
        return seen

    def scan(
        self,
        still: Target,
        moving: Target | None,
        pose: FloatArray,
        rng: np.random.Generator,
        firing: FloatArray | None = None,
    ) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
        """One turn at the sensor's `pose` (4, 4): points (N, 4) with intensity in 0..1, and `.label` words (N,).

        With poses (columns, 4, 4) of each `firing` the sensor moves meanwhile, and each point is seen from its own.
        """
        rotation, origin = pose[:3, :3].astype(np.float32), pose[:3, 3].astype(np.float32)
        rays = self.directions @ rotation.T
        if firing is not None:
            turned = firing[self.column].astype(np.float32)
            rays, origin = np.einsum("nij,nj->ni", turned[:, :3, :3], self.directions), turned[:, :3, 3]
        distance, word, material, cosine = _strike(still, origin, rays)
        if moving is not None:
            chosen = (
                np.flatnonzero(self._towards(moving.mesh, pose)[self.column])
                if firing is None
                else np.arange(len(rays))
            )
            near = _strike(moving, origin if firing is None else origin[chosen], rays[chosen])
            closer = near[0] < distance[chosen]
            chosen = chosen[closer]
            distance[chosen], word[chosen] = near[0][closer], near[1][closer]
            material[chosen], cosine[chosen] = near[2][closer], near[3][closer]
        draw = rng.random((2, len(rays)), np.float32)
        noise = rng.standard_normal(len(rays), np.float32)
        light = _REFLECTANCE[material] * cosine
        near_enough = (distance > self.nearest) & (distance < self.farthest)
        signal = light * (self.farthest / np.maximum(distance, 1)) ** 2
        kept = near_enough & (draw[0] > self.lost + _LOST[material]) & (draw[1] > np.exp(-signal / self.faint))
        measured = distance + self.noise * noise
        points = np.empty((int(kept.sum()), 4), np.float32)
        points[:, :3] = self.directions[kept] * measured[kept, None]
        points[:, 3] = np.round(np.clip(light[kept] * (0.9 + 0.1 * noise[kept]), 0, 0.99), 2)
        return points, word[kept]

    def _towards(self, mesh: Mesh, pose: FloatArray) -> NDArray[np.bool_]:
        """Firings (columns,) in whose plane a vertex lies, or that lie between two vertices of one face."""
        local = (mesh.vertices - pose[:3, 3]) @ pose[:3, :3]
        angle = np.arctan2(local[:, 1], local[:, 0])[mesh.faces]
        first = angle[:, :1]
        turn = (angle - first + np.pi) % (2 * np.pi) - np.pi
        step = 2 * np.pi / self.columns
        low = np.floor((first[:, 0] + turn.min(axis=1)) / step).astype(np.intp) - 1
        high = np.ceil((first[:, 0] + turn.max(axis=1)) / step).astype(np.intp) + 1
        # Marks of where intervals open and close, on three turns laid side by side, summed up.
        marks = np.zeros(3 * self.columns + 1, np.intp)
        np.add.at(marks, np.clip(low + self.columns, 0, None), 1)
        np.add.at(marks, np.clip(high + self.columns, None, 3 * self.columns), -1)
        covered = marks.cumsum()[:-1].reshape(3, self.columns).max(axis=0) > 0
        return np.asarray(covered)


@dataclass(frozen=True)
class Rings(HDL64E):
    """A scanner whose beams stand at other angles, and that sees all around.

    Args:
        beams: degrees above the horizon, top beam first.
    """

    beams: tuple[float, ...] = ()

    @cached_property
    def elevation(self) -> FloatArray:
        """(beams,) radians, top beam first."""
        angles: FloatArray = np.radians(np.array(self.beams, np.float64))
        return angles

    @cached_property
    def _seen(self) -> NDArray[np.bool_]:
        return np.ones(len(self.beams) * self.columns, np.bool_)


# By their number of beams; angles and firings a turn at 10 Hz as the manuals of VLP-16, HDL-32E and OS1-128 have them.
SENSORS: dict[int, HDL64E] = {
    16: Rings(columns=1800, farthest=100.0, beams=tuple(15.0 - 2.0 * k for k in range(16))),
    32: Rings(columns=2170, beams=tuple(10.67 - 4 / 3 * k for k in range(32))),
    64: HDL64E(),
    128: Rings(columns=1024, beams=tuple(22.5 - 45 / 127 * k for k in range(128))),
}


def _strike(
    target: Target, origin: NDArray[np.float32], rays: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.uint32], NDArray[np.uint8], NDArray[np.float32]]:
    """Distance (inf: none), label word, material and cosine of the angle of incidence of each ray's first hit."""
    hits = target.hit(origin, rays)
    face = hits["primID"].astype(np.intp)
    normal = hits["Ng"].astype(np.float32)
    missed = face < 0
    distance = hits["tfar"].astype(np.float32)
    distance[missed] = np.inf
    length = np.sqrt(np.einsum("ij,ij->i", normal, normal))
    cosine: NDArray[np.float32] = np.abs(np.einsum("ij,ij->i", normal, rays)) / np.maximum(length, np.float32(1e-12))
    return distance, target.word[face], target.mesh.material[face], cosine
