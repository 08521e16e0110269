"""A forecast where it lies in the world, without the ego that it was made for: what a planner can take.

A forecast is of measurements, each in the grid of an ego that it takes to drive on.  Two things in it are no obstacles
to another path: the cells under that ego, which the mapping marks as occupied, and the trail that they leave behind it
until they are measured again.  Both are replaced by what was told of the same place before that ego came there.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from envpred.datamodules import Forecast, Seen
from envpred.errors import UserError
from envpred.mapping.ego_motion import EgoMotion, cells_of, ego_futures
from envpred.mapping.evidence import pignistic
from envpred.mapping.geometry import UNKNOWN, FloatArray
from envpred.mapping.rays import mark_ego

Grids = NDArray[np.float32]

LEAST = 0.05  # mass of a cell of which something is known; what was measured once has less after 2.8 s
TRAIL = 0.5  # seconds after which the cells that an ego has left are believed again


@dataclass(frozen=True)
class PlacedForecast:
    """A forecast of N frames, and what is known at the present.  All grids lie on one lattice.

    Args:
        probability: (N, H, W) of occupied, each in the grid whose centre cell holds the ego of that horizon.
        ego: (N, 3) where it takes the ego to go: x and y in cells of the lattice, heading in radians.
        present: (H', W') probability of occupied at the last frame shown, on the judged or the wider grid.
        known: (H', W') bool, of which cells of it anything is known.
        now: (3,) pose of the ego at the last frame shown.
        sensor: pose of the sensor in the body frame: metres ahead and to the left, heading.
        body: rear, front and half width of the ego's body in the sensor frame, metres.
        origin: (2,) where in the world lattice cell (0, 0) lies, metres.
        resolution: side of a cell in metres.
        period: seconds between frames.
        time: of the last frame shown, seconds.
        samples: (K, N, H, W) equally likely futures, each in the grids of an ego of its own.
        sample_ego: (K, N, 3) where these go.

    Raises:
        ValueError: if the shapes do not belong together.
    """

    probability: Grids
    ego: FloatArray
    present: Grids
    known: NDArray[np.bool_]
    now: FloatArray
    sensor: tuple[float, float, float]
    body: tuple[float, float, float]
    origin: tuple[float, float]
    resolution: float
    period: float
    time: float = 0.0
    samples: Grids | None = None
    sample_ego: FloatArray | None = None

    def __post_init__(self) -> None:
        N, H, W = self.probability.shape
        fits = self.ego.shape == (N, 3) and self.present.shape == self.known.shape and self.now.shape == (3,)
        if self.samples is not None:
            K = len(self.samples)
            fits &= self.samples.shape == (K, N, H, W)
            fits &= self.sample_ego is not None and self.sample_ego.shape == (K, N, 3)
        if not fits:
            raise ValueError(f"grids and egos do not belong together: {self.probability.shape}, {self.ego.shape}")

    @classmethod
    def of(
        cls,
        forecast: Forecast,
        seen: Seen,
        origin: FloatArray,
        time: float = 0.0,
        futures: FloatArray | None = None,
        motion: EgoMotion | None = None,
    ) -> Self:
        """The forecast of a batch of one window, as `Forecaster.forecast` gives it.

        Args:
            forecast: of that window.
            seen: what it was made from.
            origin: of the lattice, as `Mapper.origin`.
            time: of the last frame shown, seconds.
            futures: (K, N, 3) egos of the forecast's samples, as `RolloutForecaster.futures` gives them; without them
                samples are left out, because nobody knows where they lie.
            motion: how the ego drives on.

        Raises:
            UserError: if there is more than one window.
        """
        if len(seen["pose"]) != 1:
            raise UserError(f"a batch of {len(seen['pose'])} windows: place the forecast of one at a time")
        pose, times = (np.asarray(seen[name][0].cpu(), np.float64) for name in ("pose", "time"))
        horizons = forecast.probability.shape[1]
        resolution = float(seen["resolution"])
        (ego,) = ego_futures(pose, times, horizons, 1, np.random.default_rng(0), motion or EgoMotion(), resolution)
        present, known = _known(seen)
        east, north, heading = seen["sensor"][0].tolist()
        rear, front, half_width = seen["body"][0].tolist()
        drawn = None if futures is None or forecast.samples is None else np.asarray(forecast.samples[0].cpu())
        return cls(
            np.asarray(forecast.probability[0].cpu(), np.float32),
            ego,
            present,
            known,
            pose[-1],
            (east, north, heading),
            (rear, front, half_width),
            (float(origin[0]), float(origin[1])),
            resolution,
            float(seen["period"]),
            time,
            drawn,
            None if drawn is None else futures,
        )

    @property
    def horizon_s(self) -> FloatArray:
        """Seconds (N,) from the last frame shown to each horizon."""
        return np.asarray(self.period * np.arange(1, len(self.probability) + 1), np.float64)

    def told(self) -> Grids:
        """The probability (N, H, W) without the ego; not a number where nothing is known of a cell."""
        return self._without_ego(self.probability, self.ego, self.resolution)

    def sampled(self) -> Iterator[tuple[Grids, FloatArray]]:
        """The same of each sample, and its ego (N, 3)."""
        if self.samples is not None and self.sample_ego is not None:
            for grids, ego in zip(self.samples, self.sample_ego, strict=True):
                yield self._without_ego(grids, ego, 0.0), ego

    def _without_ego(self, grids: Grids, ego: FloatArray, margin: float) -> Grids:
        """`grids` (N, H, W) of one `ego` (N, 3), which is up to `margin` metres elsewhere."""
        here, there = cells_of(self.now) - self.present.shape[0] // 2, cells_of(ego) - grids.shape[-1] // 2
        first = np.minimum(here, there.min(axis=0))
        size = np.maximum(here + self.present.shape[0], there.max(axis=0) + grids.shape[-1]) - first

        def region(corner: NDArray[np.int64], cells: int) -> tuple[slice, slice]:
            i, j = (corner - first).tolist()
            return slice(i, i + cells), slice(j, j + cells)

        def under(pose: FloatArray) -> NDArray[np.bool_]:
            east, north, turn = self.sensor
            cos, sin = np.cos(pose[2]), np.sin(pose[2])
            x = pose[0] - first[0] + (east * cos - north * sin) / self.resolution
            y = pose[1] - first[1] + (east * sin + north * cos) / self.resolution
            rear, front, half_width = self.body
            body = rear - margin, front + margin, half_width + margin
            cells = np.zeros(tuple(size), np.bool_)
            mark_ego(cells, x, y, pose[2] + turn, body, self.resolution, True)
            return cells

        before, known = np.full(tuple(size), np.nan, np.float32), np.zeros(tuple(size), np.bool_)
        at = region(here, self.present.shape[0])
        before[at], known[at] = self.present, self.known
        own = under(self.now)
        before[own], known[own] = 0, True  # where the ego stands, nothing else does
        left = np.where(own, 0.0, np.inf)  # seconds since the ego was there
        told = np.empty_like(grids)
        for n, (grid, pose, corner) in enumerate(zip(grids, ego, there, strict=True)):
            left = np.where(under(pose), 0.0, left + self.period)
            at = region(corner, grid.shape[-1])
            believed = left[at] > TRAIL
            before[at] = np.where(believed, grid, before[at])
            told[n] = np.where(known[at], before[at], np.nan)
        return told


def _known(seen: Seen) -> tuple[Grids, NDArray[np.bool_]]:
    """Probability of occupied at the last frame shown, and of which cells anything is known (H', W').

    Without evidence, that is where it is not even, or this very frame has measured something.
    """
    arrays = {name: np.asarray(array[0, -1].float().cpu(), np.float32) for name, array in seen["arrays"].items()}
    if "evidence" in arrays:
        mass = within(arrays["evidence"], arrays.get("context_evidence"))
        return pignistic(mass), mass.sum(axis=0) >= LEAST
    present = np.asarray(seen["occupancy"][0, -1].cpu(), np.float32)
    measured = np.asarray(seen["label"][0, -1].cpu()) != UNKNOWN
    return present, measured | (np.abs(present - 0.5) >= LEAST / 2)


def within(mass: Grids, wide: Grids | None) -> Grids:
    """Evidence (2, H, W) of the judged grid within that of the wider one (2, W', W'), where there is one."""
    if wide is None:
        return mass
    rim, both = (wide.shape[-1] - mass.shape[-1]) // 2, wide.copy()
    both[:, rim : rim + mass.shape[-1], rim : rim + mass.shape[-1]] = mass
    return both
