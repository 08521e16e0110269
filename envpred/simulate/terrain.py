"""The ground: which surface lies where, and how high; roads with crown, kerbs and potholes on land that is not flat."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from scipy.ndimage import distance_transform_edt, gaussian_filter

from envpred.simulate import classes
from envpred.simulate.mesh import MATERIAL, FloatArray, Mesh, join, mesh
from envpred.simulate.traffic import LANES, Network

CELL = 0.25  # metres
MARGIN = 85.0  # metres of ground around the path; more than the sensor's range minus a car's length
_FINE = 24.0  # metres from the path within which the mesh has cells of CELL
_COARSE = 5  # cells of CELL in a side of the mesh further out
_KERB = 0.12  # metres
_CROWN = 0.022  # rise of a road from its edge to its middle, per metre
_MATERIALS = {classes.ROAD: "asphalt", classes.PARKING: "asphalt", classes.SIDEWALK: "paving", classes.TERRAIN: "grass"}


@dataclass(frozen=True)
class Hills:
    """Low waves: amplitudes in metres, wave vectors (n, 2) in radians a metre, phases."""

    amplitude: FloatArray
    wave: FloatArray
    phase: FloatArray

    @classmethod
    def draw(cls, slope: float, rng: np.random.Generator) -> "Hills":
        """Hills whose steepest waves rise by about `slope`."""
        length, angle = rng.uniform(110, 420, 6), rng.uniform(0, 2 * np.pi, 6)
        wave = 2 * np.pi / length[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return cls(slope / np.hypot(*wave.T) * rng.uniform(0.2, 0.6, 6), wave, rng.uniform(0, 2 * np.pi, 6))

    def height(self, places: FloatArray) -> FloatArray:
        """Height (...,) at `places` (..., 2)."""
        waves: FloatArray = np.sin(places @ self.wave.T + self.phase) @ self.amplitude
        return waves


class Terrain:
    """The ground around a path.

    Attributes:
        origin: (2,) position of the centre of raster cell (0, 0), metres.
        surface: (X, Y) class numbers of the ground.
        detail: (X, Y) height above the hills, metres.
    """

    def __init__(self, network: Network, path: FloatArray, slope: float, rng: np.random.Generator) -> None:
        self.hills = Hills.draw(slope, rng)
        self.origin = path.min(axis=0) - MARGIN
        width, height = np.ceil((np.ptp(path, axis=0) + 2 * MARGIN) / CELL)
        self.shape = int(width), int(height)
        self.surface = self._paint(network)
        self.detail = self._relief(rng)
        on_path = np.ones(self.shape, bool)
        on_path[tuple(self.cell(path).T)] = False
        self.from_path = distance_transform_edt(on_path, sampling=CELL)

    def cell(self, places: FloatArray) -> NDArray[np.intp]:
        """Raster cell (..., 2) of `places` (..., 2); those outside get the nearest."""
        cells = np.round((places - self.origin) / CELL).astype(np.intp)
        inside: NDArray[np.intp] = np.clip(cells, 0, np.array(self.shape) - 1)
        return inside

    def height(self, places: FloatArray) -> FloatArray:
        """Height of the ground (...,) at `places` (..., 2)."""
        cells = self.cell(places)
        height: FloatArray = self.hills.height(places) + self.detail[cells[..., 0], cells[..., 1]]
        return height

    def street(self) -> NDArray[np.bool_]:
        """(X, Y) where no house may stand: roads, parking strips, pavements."""
        street: NDArray[np.bool_] = self.surface != classes.TERRAIN
        return street

    def _paint(self, network: Network) -> NDArray[np.uint8]:
        image = Image.new("L", self.shape, classes.TERRAIN)
        draw = ImageDraw.Draw(image)

        def points(line: FloatArray) -> list[tuple[float, float]]:
            return [(float(x), float(y)) for x, y in (line - self.origin) / CELL]

        def paint(kinds: tuple[str, ...], label: int, wider: float = 0.0) -> None:
            for kind, width, line in network.lanes:
                if LANES[kind] in kinds:
                    draw.line(points(line), fill=label, width=round((width + wider) / CELL), joint="curve")

        for outline in network.junctions:
            draw.polygon(points(outline), fill=classes.SIDEWALK)
        paint(("sidewalk",), classes.SIDEWALK, 0.3)
        paint(("driving", "parking", "cycleway"), classes.ROAD, 0.6)  # closes the slits between lanes
        for kind, _, line in network.lanes:
            if LANES[kind] == "walkingarea" and len(line) > 2:
                draw.polygon(points(line), fill=classes.SIDEWALK)
        paint(("sidewalk",), classes.SIDEWALK)
        paint(("parking",), classes.PARKING)
        paint(("driving", "cycleway", "crossing"), classes.ROAD)
        paint(("junction",), classes.ROAD, 0.8)
        return np.asarray(image, np.uint8).T.copy()

    def _relief(self, rng: np.random.Generator) -> NDArray[np.float32]:
        road = np.isin(self.surface, (classes.ROAD, classes.PARKING))
        inwards = distance_transform_edt(road, sampling=CELL)
        noise = rng.standard_normal(self.shape, np.float32)
        detail = np.where(road, _CROWN * np.minimum(inwards, 3.5), _KERB).astype(np.float32)
        grass = self._waves(8, rng).clip(0, 2)
        detail += gaussian_filter(noise, 1.2) * np.where(self.surface == classes.TERRAIN, 0.1 + 0.3 * grass, 0.02)
        # Gardens rise and fall away from the pavement.
        street = self.surface != classes.TERRAIN
        away = np.minimum(distance_transform_edt(~street, sampling=CELL) / 10, 1.0)
        detail += (0.6 * away * self._waves(16, rng)).astype(np.float32)
        for x, y in np.argwhere(road)[rng.integers(0, max(road.sum(), 1), road.sum() // 6000)] if road.any() else ():
            self._pothole(detail, int(x), int(y), rng.uniform(0.3, 0.7), rng.uniform(0.02, 0.06))
        return detail

    def _waves(self, coarseness: int, rng: np.random.Generator) -> FloatArray:
        """A smooth random field (X, Y) of unit variance with waves of about 20 `coarseness` cells."""
        coarse = gaussian_filter(rng.standard_normal([n // coarseness + 2 for n in self.shape]), 3)
        fine = Image.fromarray(coarse.astype(np.float32)).resize(self.shape[::-1], Image.Resampling.BICUBIC)
        return np.asarray(fine, np.float64) / max(float(coarse.std()), 1e-9)

    def _pothole(self, detail: NDArray[np.float32], x: int, y: int, radius: float, depth: float) -> None:
        reach = int(np.ceil(radius / CELL))
        xs, ys = (np.arange(max(c - reach, 0), min(c + reach + 1, n)) for c, n in zip((x, y), self.shape, strict=True))
        distance = np.hypot(xs[:, None] - x, ys[None] - y) * CELL
        detail[np.ix_(xs, ys)] -= depth * np.maximum(0, 1 - (distance / radius) ** 2)

    def mesh(self) -> Mesh:
        """The ground as triangles: fine near the path, coarse further out, without a slit between the two."""
        fine = self.from_path[:-1, :-1] < _FINE
        coarse = self.from_path[::_COARSE, ::_COARSE][:-1, :-1] >= _FINE - 2 * _COARSE * CELL
        return join([self._quads(fine, 1, 0.0), self._quads(coarse, _COARSE, -0.03)])

    def _quads(self, wanted: NDArray[np.bool_], stride: int, lower: float) -> Mesh:
        """Two triangles for every wanted cell of the raster thinned by `stride`, `lower` metres higher."""
        x, y = np.nonzero(wanted)
        corners = np.stack([np.stack([x + a, y + b], 1) for a, b in ((0, 0), (1, 0), (1, 1), (0, 1))], 1) * stride
        columns = self.shape[1]
        used, index = np.unique(corners[..., 0] * columns + corners[..., 1], return_inverse=True)
        index = index.reshape(-1, 4)
        i, j = used // columns, used % columns
        places = np.stack([i, j], 1) * CELL + self.origin
        height = self.hills.height(places) + self.detail[i, j] + lower
        label = self.surface[x * stride, y * stride]
        table = np.zeros(256, np.uint8)
        for kind, material in _MATERIALS.items():
            table[kind] = MATERIAL[material]
        faces = np.concatenate([index[:, [0, 1, 2]], index[:, [0, 2, 3]]])
        return mesh(np.column_stack([places, height]), faces, np.tile(label, 2), table[np.tile(label, 2)])
