"""A Velodyne HDL-64E at 10 Hz on the roof of KITTI's car: rays by Embree, ranges, intensities and losses of our own.

Scanners of 16, 32 and 128 beams stand beside it (`SENSORS`).  The sweep is frozen: all rays of a scan leave from the
pose at its middle, so the ego's motion during the 0.1 s of a turn bends nothing, unless each firing has a pose.  What
differs from scan to scan although nothing drives is `Clutter`: leaves, blades of grass, edges.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from envpred.compiled import njit
from envpred.simulate.clutter import NO_CLUTTER, Clutter, blend, graze, pass_leaves
from envpred.simulate.mesh import MATERIALS, FloatArray, Mesh
from envpred.simulate.rays import Struck, Target, strike

_REFLECTANCE, _LOST = np.array(list(MATERIALS.values()), np.float32).T


@dataclass(frozen=True)
class HDL64E:
    """The sensor (Velodyne's manual of the HDL-64E S2; beams and what its car hides of the view as in KITTI's scans).

    Args:
        columns: firings a turn, 0.167 degrees apart: KITTI's sensor turned at 9.68 Hz.
        nearest, farthest: returns nearer or farther (metres) are not recorded; KITTI keeps 80 m.
        noise: standard deviation of a range, metres.
        faint: returned share of the light, at 80 m face on, at which two of three returns are lost.
    """

    columns: int = 2152
    nearest: float = 0.9
    farthest: float = 80.0
    noise: float = 0.018
    faint: float = 0.004

    @cached_property
    def elevation(self) -> FloatArray:
        """(64,) radians, top beam first: two blocks of 32 lasers, about 1/3 and 1/2 degree apart."""
        upper = np.linspace(1.94, -8.66, 32)
        lower = np.linspace(-9.06, -24.96, 32)
        angles: FloatArray = np.radians(np.concatenate([upper, lower]))
        return angles

    @cached_property
    def lift(self) -> FloatArray:
        """(64,) metres above the sensor's origin from which each beam leaves: its two blocks of lasers stand apart."""
        return np.repeat([0.204, 0.121], 32)

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

    @cached_property
    def _lifted(self) -> NDArray[np.float32]:
        """How far above the sensor's origin each ray leaves, metres (rays,)."""
        lifted: NDArray[np.float32] = np.repeat(self.lift, self.columns)[self._seen].astype(np.float32)
        return lifted

    def scan(
        self,
        still: Target,
        moving: Target | None,
        pose: FloatArray,
        rng: np.random.Generator,
        firing: FloatArray | None = None,
        clutter: Clutter = NO_CLUTTER,
    ) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
        """One turn at the sensor's `pose` (4, 4): points (N, 4) with intensity in 0..1, and `.label` words (N,).

        With poses (columns, 4, 4) of each `firing` the sensor moves meanwhile, and each point is seen from its own.
        """
        if firing is None:
            rotation = pose[:3, :3].astype(np.float32)
            rays = self.directions @ rotation.T
            # Axis by axis: NumPy takes three times as long to do rows of three at once.
            start = np.empty_like(rays)
            for axis, place in enumerate(pose[:3, 3].astype(np.float32)):
                np.add(place, self._lifted * rotation[axis, 2], out=start[:, axis])
        else:
            turned = firing[self.column].astype(np.float32)
            rays = np.einsum("nij,nj->ni", turned[:, :3, :3], self.directions)
            start = turned[:, :3, 3] + self._lifted[:, None] * turned[:, :3, 2]
        struck = strike(still, start, rays)
        pass_leaves(struck, still, start, rays, clutter.porosity, rng)
        if moving is not None:
            chosen = np.arange(len(rays))
            if firing is None:
                chosen = np.flatnonzero(self._nearest(moving.mesh, pose)[self.column] < struck.distance)
            near = strike(moving, start[chosen], rays[chosen])
            closer = near.distance < struck.distance[chosen]
            struck.put(chosen[closer], near.of(closer))
        measured = struck.distance + self.noise * rng.standard_normal(len(rays), np.float32)
        graze(measured, struck, clutter.grass, rng)
        blend(measured, clutter.mixed, rng)
        light = _REFLECTANCE[struck.material] * struck.cosine
        kept = np.flatnonzero(self._returned(struck, light, clutter.lost, rng))
        points = np.empty((len(kept), 4), np.float32)
        ranges = measured.take(kept)
        for axis in range(3):
            np.multiply(self.directions[:, axis].take(kept), ranges, out=points[:, axis])
        points[:, 2] += self._lifted.take(kept)
        glint = 0.9 + 0.1 * rng.standard_normal(len(points), np.float32)
        points[:, 3] = np.round(np.clip(light.take(kept) * glint, 0, 0.99), 2)
        return points, struck.word.take(kept)

    def _returned(
        self, struck: Struck, light: NDArray[np.float32], lost: float, rng: np.random.Generator
    ) -> NDArray[np.bool_]:
        """Which rays (N,) come back: in reach, bright enough, and not lost."""
        draw = rng.random((2, len(light)), np.float32)
        signal = light * (self.farthest / np.maximum(struck.distance, 1)) ** 2
        kept = (struck.distance > self.nearest) & (struck.distance < self.farthest)
        kept &= (draw[0] > lost + _LOST[struck.material]) & (draw[1] > np.exp(-signal / self.faint))
        return np.asarray(kept)

    def _nearest(self, mesh: Mesh, pose: FloatArray) -> NDArray[np.float32]:
        """Metres (columns,) that what a firing meets of a mesh is away at least; inf for those that cannot meet it."""
        local = (mesh.vertices - pose[:3, 3]) @ pose[:3, :3]
        angle, away = np.arctan2(local[:, 1], local[:, 0]), np.hypot(local[:, 0], local[:, 1])
        nearest = np.full(self.columns, np.inf, np.float32)
        _look_at_faces(nearest, local, angle, away, mesh.faces)
        return nearest


@njit(nogil=True)
def _look_at_faces(nearest, vertices, angle, away, faces):  # type: ignore[no-untyped-def]
    """Lowers `nearest` (columns,) in each firing between two vertices of a face, and in one more at either side."""
    columns = len(nearest)
    step = 2 * np.pi / columns
    for a, b, c in faces:
        first = angle[a]
        turn_b = (angle[b] - first + np.pi) % (2 * np.pi) - np.pi
        turn_c = (angle[c] - first + np.pi) % (2 * np.pi) - np.pi
        low = int(np.floor((first + min(0.0, turn_b, turn_c)) / step)) - 1
        high = int(np.ceil((first + max(0.0, turn_b, turn_c)) / step)) + 1
        # No point of a face is farther from its nearest vertex than the face's sides are long.
        longest = 0.0
        for u, v in ((a, b), (b, c), (c, a)):
            x, y, z = vertices[u] - vertices[v]
            longest = max(longest, np.sqrt(x * x + y * y + z * z))
        least = min(away[a], away[b], away[c]) - longest
        for column in range(low, high):
            nearest[column % columns] = min(nearest[column % columns], least)


@dataclass(frozen=True)
class Rings(HDL64E):
    """A scanner whose beams stand at other angles, leave from one place, and see all around.

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
    def lift(self) -> FloatArray:
        """(beams,) metres above the origin: none."""
        return np.zeros(len(self.beams))

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
