"""Forecasts by measuring again: the sensor's future measurements of a remembered world, and the evidence they give.

What is forecast is a measurement.  For an ego future, a step of the rollout puts the sensor where it will be, casts its
rays into the world, and fuses what they meet with the masses of the step before, as the mapping does.  The world is the
probability that a cell is hit by the scan, on a context grid that is wider than the one that is judged:

* a hit cell is measured as occupied whatever lies before it in the plane, because the scanner looks over low things;
* another is measured as free if a ray passes it before being stopped: with probability T, the transmittance, the
  product of 1 - hit over the cells before it on the ray; the largest over the rays of the cell;
* cells under the ego are the ego's; the others are not measured;
* cells that enter the judged grid carry no mass.

Rendering from the future sensor was proposed for point clouds by Khurana et al. (CVPR 2023).
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from envpred.errors import UserError
from envpred.mapping.evidence import PAPER, EvidenceParameters, Mass
from envpred.mapping.geometry import EGO, FREE, OCCUPIED, PAPER_BODY, FloatArray, GridSpec
from envpred.mapping.measurement import roll
from envpred.mapping.measurement_gradient import roll_back
from envpred.mapping.movers import Movers, carried_on
from envpred.mapping.world import Grids, World, check_context

CHUNKS = (
    4  # parts that the futures are summed in: the sum's order, and so its bits, are the same on any number of threads
)


class Mapper(Protocol):
    """Calls in order or at once: `map` itself, or that of a thread pool (the loops hold no lock of the interpreter)."""

    def __call__(self, function: Callable[[Any], Any], arguments: Iterable[Any], /) -> Iterator[Any]: ...


class Scene(NamedTuple):
    """What is known at the last frame shown, and where the ego goes from there.

    Args:
        mass: (2, H, W) posterior masses of the last frame shown.
        world: what scans meet, on the context grid of that frame.
        centre_cell: (2,) lattice cell at the centre of that frame's grids.
        futures: (K, N, 3) poses of the ego, in cells and radians, one a frame.
        movers: what moves on its own.
        draws: (K, 2) standard normal draws of the movers' velocities, one for each future; by default their means.
        weights: (K, N) of the futures at each horizon, see `ego_motion.cell_weights`; by default all alike.
    """

    mass: Mass
    world: World
    centre_cell: NDArray[np.integer]
    futures: FloatArray
    movers: Movers | None = None
    draws: FloatArray | None = None
    weights: FloatArray | None = None


@dataclass(frozen=True)
class Rollout:
    """The sensor and the mapping that the future is measured with.

    Args:
        sensor: place of the sensor in the body frame, forward and left, in metres.
        sensor_heading: heading of the sensor in the body frame, radians.
        grid: the judged grid.
        body: rear, front and half width of the ego's body in the sensor's frame, metres.
        evidence: masses of a measurement, and how fast they fade.
        period: seconds between frames.
        least: a ray ends where its transmittance falls below this.
        clump: how much of what may be hit in one of many cells is the same thing, see `measurement`; 0 if nothing is.
        remembered: share of the last frame itself in the forecast where the ego stands: what is measured again from
            the same place and what was measured there err apart, so that their mean is better than either.
        beyond: probability of a hit in cells beyond the context; None refuses a motion that leaves the context.
    """

    sensor: tuple[float, float]
    sensor_heading: float = 0.0
    grid: GridSpec = field(default_factory=GridSpec)
    body: tuple[float, float, float] = (PAPER_BODY.rear, PAPER_BODY.front, PAPER_BODY.half_width)
    evidence: EvidenceParameters = PAPER
    period: float = 0.1
    least: float = 0.02
    clump: float = 0.05
    remembered: float = 0.8
    beyond: float | None = None

    def __post_init__(self) -> None:
        reach = (self.grid.half - 2) * self.grid.resolution
        if not np.hypot(*self.sensor) < reach:
            raise UserError(
                f"the sensor at {self.sensor} m lies outside the grid of {self.grid.side:.1f} m; check its place"
            )

    def mirrored(self) -> "Rollout":
        """The rollout of a mirrored world, where left is right."""
        return replace(self, sensor=(self.sensor[0], -self.sensor[1]), sensor_heading=-self.sensor_heading)

    def expected(self, scene: Scene, mapper: Mapper = map, offset: tuple[int, int] = (0, 0)) -> Grids:
        """The forecast (N, H, W): the mean over the futures of the expected probability of occupied.

        In expectation over hits that come and go a cell's masses are m' = q fuse(m, occupied) + (1 - q) T fuse(m, free)
        + (1 - q) (1 - T) age(m), with q its probability of a hit and T its transmittance.

        Args:
            scene: what is known.
            mapper: `map`, or that of a thread pool.
            offset: centre cells of the future grids less the cells that hold the ego: 0, but 1 on an axis that has been
                turned round, because a grid has a cell more to the west of its centre cell.

        Raises:
            UserError: if the context is smaller than the grid, or a future leaves it.
        """
        return np.minimum(self._mean(1, scene, mapper, offset)[:, 0], 1)  # rounding

    def rendered(self, scene: Scene, mapper: Mapper = map, offset: tuple[int, int] = (0, 0)) -> Grids:
        """What the forecast is made of (N, 4, H, W): expected m(O), m(F), chances of a hit and of being seen free.

        Args, Raises: as `expected`.
        """
        return self._mean(4, scene, mapper, offset)

    def gradient(self, of: Grids, scene: Scene, mapper: Mapper = map, offset: tuple[int, int] = (0, 0)) -> Grids:
        """The gradient by `world.hit`, of its shape, of something whose gradient by the forecast is `of`.

        Args: `of` (N, 1, H, W) by what is `expected`, or (N, 4, H, W) by what is `rendered`; as these.
        """
        given, base = self._checked(scene, offset)

        def one(out: Grids, k: int, weights: Grids) -> None:
            roll_back(out, of, *self._arguments(given, base, k, weights, offset))

        found = _summed(one, given.world.hit.shape, scene, mapper)
        rim = (found.shape[-1] - scene.world.hit.shape[-1]) // 2
        return found[:, rim : found.shape[1] - rim, rim : found.shape[2] - rim]

    def _mean(self, channels: int, scene: Scene, mapper: Mapper, offset: tuple[int, int]) -> Grids:
        """Means (N, channels, H, W) over the futures of what `roll` adds up."""
        given, base = self._checked(scene, offset)

        def one(out: Grids, k: int, weights: Grids) -> None:
            roll(out, *self._arguments(given, base, k, weights, offset))

        return _summed(one, (scene.futures.shape[1], channels, *scene.mass.shape[1:]), scene, mapper)

    def samples(
        self,
        scene: Scene,
        generator: np.random.Generator,
        mapper: Mapper = map,
        offset: tuple[int, int] = (0, 0),
    ) -> Grids:
        """Forecasts (K, N, H, W), one for each future, in a world whose hits are drawn, frame by frame.

        Args, Raises: as `expected`; `generator` draws the hits.  The futures count alike.
        """
        given, base = self._checked(scene, offset)
        K, N, _ = scene.futures.shape
        drawn = np.zeros((K, N, 1, *scene.mass.shape[1:]), np.float32)
        seeds: list[int] = np.asarray(generator.integers(1, 1 << 63, size=K)).tolist()

        def sample(k: int) -> None:
            roll(drawn[k], *self._arguments(given, base, k, np.ones(N, np.float32), offset, seeds[k]))

        list(mapper(sample, range(K)))
        return drawn[:, :, 0]

    def _checked(self, scene: Scene, offset: tuple[int, int]) -> tuple[Scene, NDArray[np.int64]]:
        """The scene, its world with a rim where futures leave it, and the lattice cell of the world's first cell."""
        mass, world, centre_cell, futures = scene[:4]
        cells, half = self.grid.cells, self.grid.half
        if futures.ndim != 3 or futures.shape[2] != 3:
            raise ValueError(f"futures (K, N, 3) expected, not {futures.shape}")
        if mass.shape != (2, cells, cells):
            raise ValueError(f"masses (2, {cells}, {cells}) expected, not {mass.shape}")
        if world.context is None and world.hit.shape[-1] != world.hit.shape[-2]:
            raise ValueError(f"a square context expected, not {world.hit.shape}")
        for grids in (world.hit, world.hit if world.seen is None else world.seen):
            if len(grids) not in (1, futures.shape[1]) or grids.shape[1:] != world.hit.shape[1:] or world.cells % 2:
                raise ValueError(f"contexts (1 or {futures.shape[1]}, I, J) expected, not {grids.shape}")
        check_context(world.cells, cells)
        centres = np.floor(futures[..., :2] + 0.5)
        if not (np.abs(centres) < 2**31).all():
            raise UserError("a future pose is not finite, or beyond every lattice; check the poses")
        base = np.asarray(centre_cell, np.int64) - world.cells // 2 + world.first
        corner = centres.astype(np.int64) + offset - half - base
        short = int(max(-corner.min(), (corner + cells - world.hit.shape[1:]).max(), 0))
        if short:
            if self.beyond is None:
                raise UserError(
                    f"the ego leaves the context of {world.cells} cells by {short * self.grid.resolution:.1f} m within "
                    f"{futures.shape[1] * self.period:.1f} s; give a context of {world.cells + 2 * short} cells, or "
                    "`beyond`"
                )
            rim = ((0, 0), (short, short), (short, short))
            hit = np.pad(world.hit, rim, constant_values=np.float32(self.beyond))
            seen = None if world.seen is None else np.pad(world.seen, rim)
            world, base = replace(world, hit=hit, seen=seen), base - short
        return scene._replace(world=world), base

    def _arguments(
        self, scene: Scene, base: NDArray[np.int64], k: int, weights: Grids, offset: tuple[int, int], seed: int = 0
    ) -> tuple[Any, ...]:
        """What `roll` takes of future `k` beside what it adds to; hits are drawn if there is a `seed`."""
        world, future, draws = scene.world, scene.futures[k], scene.draws
        table = self.evidence.table()
        masses = table[OCCUPIED, 0], table[FREE, 1], table[EGO, 0], np.float32(self.evidence.discount)
        hit = np.ascontiguousarray(world.hit, np.float32)
        seen, share = hit, np.zeros(len(future), np.float32)
        if world.seen is not None:
            seen = np.ascontiguousarray(world.seen, np.float32)
            moved_off = np.linalg.norm(future[:, :2] - world.place, axis=1) * self.grid.resolution
            share = np.exp(-((moved_off / world.near) ** 2)).astype(np.float32)
            share[share < 0.01] = 0
        start = int(scene.centre_cell[0]), int(scene.centre_cell[1])
        place = (*self.sensor, self.sensor_heading, self.grid.resolution)
        reals = (np.float32(v) for v in (self.least, self.clump, self.remembered))
        numbers = (*reals, np.uint64(seed))
        draw = None if draws is None else draws[k]
        moved = carried_on(scene.movers, draw, len(future), self.period, self.grid.resolution)
        return (
            scene.mass,
            hit,
            seen,
            share,
            base,
            start,
            future,
            weights,
            offset,
            place,
            self.body,
            masses,
            numbers,
            *moved,
        )


def _summed(one: Callable[[Grids, int, Grids], None], shape: tuple[int, ...], scene: Scene, mapper: Mapper) -> Grids:
    """The sum of what `one` adds to an array of `shape` for the number and the weights of each future that differs."""
    distinct, shares = _distinct(scene)
    parts = [range(n, len(distinct), CHUNKS) for n in range(min(CHUNKS, len(distinct)))]

    def part(n: int) -> Grids:
        summed = np.zeros(shape, np.float32)
        for k in parts[n]:
            one(summed, distinct[k], shares[k])
        return summed

    total: Grids
    total, *others = mapper(part, range(len(parts)))
    for other in others:
        total += other
    return total


def _distinct(scene: Scene) -> tuple[list[int], list[Grids]]:
    """Numbers of the futures that differ, and the weights (N,) they stand for: an ego that stands has one."""
    (K, N, _), futures, draws = scene.futures.shape, scene.futures, scene.draws
    weights = np.full((K, N), 1 / K) if scene.weights is None else scene.weights
    flat = futures.reshape(K, -1) if draws is None else np.concatenate([futures.reshape(K, -1), draws], axis=1)
    _, first, inverse = np.unique(flat, axis=0, return_index=True, return_inverse=True)
    order, inverse = np.argsort(first), inverse.reshape(K)  # its shape differs between releases of NumPy
    shares = [weights[inverse == n].sum(axis=0).astype(np.float32) for n in order]
    return first[order].tolist(), shares
