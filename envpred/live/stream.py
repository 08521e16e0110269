"""One scan in, one forecast out, by the same mapper, window and forecaster as the batch path: equal to it to the bit.

stream = Stream("best.ckpt", sensor_to_body=..., sensor_height=1.73)
for points, pose, time in scans:
    forecast = stream.update(points, pose, time)      # None until enough frames have been seen
"""

import logging
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import numpy as np
import torch
from numpy.typing import NDArray

from envpred.datamodules import Forecast, Seen
from envpred.datamodules.grids import AHEAD
from envpred.drives import Drive
from envpred.drives.plausible import FARTHEST
from envpred.errors import UserError, check_number
from envpred.live.ahead import LiveForecast, counted_from, steps_beyond
from envpred.live.arrivals import Arrivals, Verdict
from envpred.live.placed import PlacedForecast
from envpred.mapping.dogma import DogmaParameters
from envpred.mapping.geometry import (
    PAPER_BODY,
    PAPER_SENSOR_HEIGHT,
    PAPER_SENSOR_OFFSET,
    Body,
    FloatArray,
    GridSpec,
)
from envpred.mapping.mapper import Mapped, Mapper, MappingParameters
from envpred.mapping.particle_state import GROUND
from envpred.mapping.period import PERIOD
from envpred.models import Forecaster, RolloutForecaster
from envpred.models.checkpoints import check_grids
from envpred.models.loading import load_forecaster

WIDER = 2  # times the judged grid's cells are those of the wide one, where nothing says how many
VELOCITIES = {"velocity", "velocity_cov", "particle_forecast"}

_log = logging.getLogger("envpred.live")


class Stream:
    """Forecasts after every scan.

    Args:
        forecaster: or its checkpoint.
        grid: cells and resolution; by default those that the weights were trained on, else the paper's.
        mapping: how scans become grids, but for the grid.
        body: the ego vehicle's body in the sensor frame.
        sensor_to_body: (4, 4) from the sensor frame to the body frame that poses are of.
        sensor_height: height of the sensor above the road, in metres.
        period: seconds between scans; by default those that the weights were trained on, else 0.1.
        origin: (2,) world position of lattice cell (0, 0) in metres; by default it follows from the first pose.
        context: cells of the wide grid, where the forecaster needs one; by default those that the weights were trained
            on, else twice the grid's.
        velocities: numbers of the particle filter, where the forecaster needs velocities; by default those relative to
            the ground.
        horizons: frames that are forecast; by default as many as reach 1.5 s ahead.
        delay: seconds between a scan and the moment that its forecast is used: forecasts count from there.
        warn: is told, a line each, what is odd about scans; by default a logger of the name envpred.live.

    Attributes:
        mapper: of the scans.
        mapped: what is known after the last scan that was taken.
        points: (N, 3) or more of that scan, those that were mapped.
        seen: what the last forecast was made of.
        forecast: the last one, as the forecaster gave it.
        starts: how often evidence has started anew.

    Raises:
        UserError: if the forecaster reads the future, or was trained on grids of another kind.
    """

    def __init__(
        self,
        forecaster: Forecaster | Path | str,
        grid: GridSpec | None = None,
        *,
        mapping: MappingParameters | None = None,
        body: Body = PAPER_BODY,
        sensor_to_body: FloatArray = PAPER_SENSOR_OFFSET,
        sensor_height: float = PAPER_SENSOR_HEIGHT,
        period: float | None = None,
        origin: FloatArray | None = None,
        context: int | None = None,
        velocities: DogmaParameters | None = None,
        horizons: int | None = None,
        delay: float = 0.0,
        warn: Callable[[str], object] = _log.warning,
    ) -> None:
        self.forecaster = forecaster if isinstance(forecaster, Forecaster) else load_forecaster(forecaster)
        self.forecaster.eval()
        needs, trained = self.forecaster.needs, (self.forecaster.trained or {}).get("data")
        if needs.future_pose:
            raise UserError(
                f"{type(self.forecaster).__name__} reads the ego's true motion, which a stream does not know; give "
                "another forecaster"
            )
        check_number("delay", delay)
        if horizons is not None:
            check_number("horizons", horizons, 1)
        known: Mapping[str, Any] = trained or {}
        if grid is None:
            grid = GridSpec(known.get("cells", GridSpec.cells), known.get("resolution", GridSpec.resolution))
        period = period or float(known.get("period", PERIOD))
        if needs.context:
            context = context or known.get("context") or WIDER * grid.cells
        wide = grid.wider(context).cells if needs.context and context is not None else None
        if trained is not None:
            here = {"period": period, "resolution": grid.resolution, "cells": grid.cells, "context": wide}
            check_grids(trained, here, needs.context, "this stream", "give it grids like those")
        self.delay, self.warn, self._asked = delay, warn, horizons
        moving = VELOCITIES & {*needs.arrays, *self.forecaster.view.arrays}
        self._make: dict[str, Any] = {
            "parameters": replace(mapping or MappingParameters(), grid=grid),
            "body": body,
            "sensor_to_body": sensor_to_body,
            "sensor_height": sensor_height,
            "context": wide,
            "velocities": (velocities or DogmaParameters(GROUND)) if moving else None,
            "with_forecast": "particle_forecast" in moving,
        }
        self._arrivals = Arrivals(period, bound=trained is not None)
        self._frames: deque[Mapped] = deque(maxlen=self.forecaster.given)
        self._told: set[str] = set()
        self.on_stage: Callable[[str], object] = _nobody_looks
        self.points = np.empty((0, 3), np.float32)
        self.seen: Seen | None = None
        self.forecast: Forecast | None = None
        self.starts = 0
        self.mapper = self._mapper(period, origin)

    @classmethod
    def of(cls, forecaster: Forecaster | Path | str, drive: Drive, **options: Any) -> Self:
        """A stream of the scans of `drive`: its car and sensor, its period, and the lattice that its poses span.

        `options` are those of a stream, but for what the drive says.
        """
        stream = cls(
            forecaster,
            body=drive.body,
            sensor_to_body=drive.sensor_to_body(),
            sensor_height=drive.sensor_height,
            period=drive.period,
            **options,
        )
        stream.mapper.origin = stream.mapper.grid.lattice_origin(drive.poses[:, :3, 3])
        return stream

    @property
    def period(self) -> float:
        """Seconds between the scans that are taken."""
        return self._arrivals.period

    @property
    def horizons(self) -> int:
        """Frames that are forecast."""
        return self._asked or max(1, round(AHEAD / self.period))

    @property
    def mapped(self) -> Mapped | None:
        return self._frames[-1] if self._frames else None

    def update(
        self, points: NDArray[np.floating], pose: FloatArray | None, time: float, delay: float | None = None
    ) -> LiveForecast | None:
        """The forecast after one more scan; None where there is none: too few frames seen, or the scan left out.

        A scan is left out if it is older than the one before, of the same time, follows it too soon, or lacks points
        or a pose.  Evidence starts anew after a gap, where the pose jumps, where the clock is set back, and at another
        rate.  Each is told in one line, and not again as long as it goes on.

        Args:
            points: (N, 3) or more columns in the sensor frame, metres; those that are not finite or too far away to be
                any are left out.
            pose: (4, 4) of the body in the world.
            time: of the scan, in seconds.
            delay: instead of the stream's.

        Raises:
            ValueError: if `points` have another shape.
        """
        if np.ndim(points) != 2 or np.shape(points)[1] < 3:
            raise ValueError(f"points (N, 3) or more columns expected, not {np.shape(points)}")
        before, self._told = self._told, set()
        clean = self._clean(np.asarray(points, np.float32), time, before)
        if not len(clean):  # whose rays would all be taken to meet nothing: free wherever one looks
            self._tell("empty", f"the scan at {time:.2f} s has no points: left out", before)
            return None
        verdict = self._arrivals.judge(pose, time)
        self._tell(verdict.kind, verdict.said, before)
        if not verdict.taken or pose is None:
            return None
        if verdict.anew:
            self._start_anew(verdict)
        self.points = clean
        self._frames.append(self.mapper.step(clean, np.asarray(pose, np.float64), time))
        if len(self._frames) < self.forecaster.given:
            return None
        found = self._forecast(self.delay if delay is None else delay)
        self.on_stage("forecast")
        return found

    def placed(self) -> PlacedForecast | None:
        """The last forecast as exports and risks take it, counted from the last scan whatever the delay."""
        if self.seen is None or self.forecast is None:
            return None
        origin, forecaster = self.mapper.origin, self.forecaster
        assert origin is not None  # a scan has given it
        reach = self.forecast.probability.shape[1]
        futures = motion = None
        if isinstance(forecaster, RolloutForecaster):
            futures, motion = np.asarray(forecaster.futures(self.seen, reach)[0]), forecaster.motion
        return PlacedForecast.of(self.forecast, self.seen, origin, self._frames[-1].time, futures, motion)

    def watch(self, on_stage: Callable[[str], object]) -> None:
        """Let `on_stage` be called with the name of each stage of an update when it is done."""
        self.on_stage = self.mapper.on_stage = on_stage

    def _forecast(self, delay: float) -> LiveForecast:
        """The forecast of the frames that follow those that were seen."""
        times = [frame.time for frame in self._frames]
        interval = (times[-1] - times[0]) / (len(times) - 1) if len(times) > 1 else self.period
        assert self.mapper.origin is not None  # the frames have given it
        with torch.inference_mode():
            self.seen = self.forecaster.see(self.mapper, list(self._frames))
            reach = self.horizons + steps_beyond(delay, interval)
            self.forecast = forecast = self.forecaster.forecast_checked(self.seen, reach)
            origin, grid = self.mapper.origin, self.mapper.grid
            return counted_from(forecast, self.seen, times[-1], interval, grid, origin, self.horizons, delay)

    def _mapper(self, period: float, origin: FloatArray | None) -> Mapper:
        mapper = Mapper(**self._make, period=period, origin=origin)
        mapper.on_stage = self.on_stage
        return mapper

    def _start_anew(self, verdict: Verdict) -> None:
        """Forget what was seen."""
        self.starts += 1
        self.seen = self.forecast = None
        self._frames.clear()
        if verdict.period is not None:
            self.mapper = self._mapper(verdict.period, self.mapper.origin)
        self.mapper.reset()
        if verdict.elsewhere:
            self.mapper.origin = None  # a lattice near the new place: positions in cells stay small numbers

    def _clean(self, points: NDArray[np.float32], time: float, before: set[str]) -> NDArray[np.float32]:
        """The points of a scan that can be some."""
        if len(points) and not np.abs([points.min(), points.max()]).max() <= FARTHEST:  # also not a number
            with np.errstate(invalid="ignore"):
                good = (np.abs(points[:, :3]) <= FARTHEST).all(axis=1)
            lost = len(points) - int(good.sum())
            if lost:
                said = f"{lost} of {len(points)} points at {time:.2f} s are not finite, or beyond {FARTHEST:.0f} m"
                self._tell("points", f"{said}: left out", before)
                points = points[good]
        return np.ascontiguousarray(points)

    def _tell(self, kind: str | None, said: str, before: set[str]) -> None:
        """Say what is odd about a scan, unless the same was said of the one before."""
        if kind is not None:
            self._told.add(kind)
            if kind not in before:
                self.warn(said)


def _nobody_looks(stage: str) -> None:
    """What is called of a stage that nobody waits for."""
