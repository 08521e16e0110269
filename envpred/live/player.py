"""A replay as one HTML page that opens from disk: scan, grid, forecasts, what then came, the error, ego futures."""

import base64
import html
import json
import zlib
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envpred.horizons import in_seconds
from envpred.live.replay import Step
from envpred.live.stream import Stream
from envpred.mapping.ego_motion import EgoMotion, ego_futures
from envpred.mapping.evidence import pignistic
from envpred.mapping.geometry import FloatArray, heading_of, transform
from envpred.store.files import replace_text

LEVELS = 20  # of a probability: steps of 0.05, which pack into two thirds of what one sees no better
FINER = 2  # pixels of the scan's picture along a cell
GROUND, OBSTACLE = 1, 2  # its values
FUTURES = 16  # of the ego, unless the forecaster has a number of its own
TEMPLATE = "player.html"


class Player:
    """Collects a replay and writes its page.

    Args:
        stream: that is replayed.
        name: of the drive.
        what: forecasts it, for the title.
        scans: in the drive.
        limit: frames with forecasts in the page at most, spread evenly; every frame's grid is there.
    """

    def __init__(self, stream: Stream, name: str, what: str, scans: int, limit: int) -> None:
        self.stream, self.name, self.what = stream, name, what
        self.stride = -(-scans // limit)
        self._grids: list[NDArray[np.uint8]] = []  # of every scan that was taken
        self._exact: list[NDArray[np.float32]] = []
        self._places: list[list[float]] = []  # time, x and y of the ego in metres, its heading, start of evidence
        self._shown: list[dict[str, Any]] = []
        self._forecasts: list[NDArray[np.float32]] = []

    def add(self, step: Step) -> None:
        """One more scan of the replay."""
        if step.mapped is None:
            return
        if step.forecast is not None and len(self._grids) % self.stride == 0:
            self._show(step)
        probability = pignistic(step.mapped.mass)
        self._exact.append(probability.astype(np.float16).astype(np.float32))
        self._grids.append(_levels(probability))
        pose = step.mapped.pose
        place = [step.mapped.time, *pose[:2, 3].tolist(), float(heading_of(pose))]
        self._places.append([*(round(value, 4) for value in place), self.stream.starts])

    def _show(self, step: Step) -> None:
        """What is shown of a scan with a forecast."""
        assert step.forecast is not None
        assert step.mapped is not None
        mapper = self.stream.mapper
        self._forecasts.append(step.forecast.probability)
        centre = self._origin + mapper.grid.resolution * step.mapped.centre_cell
        self._shown.append(
            {
                "at": len(self._grids),
                "frame": step.frame,
                "centre": centre.round(4).tolist(),
                "scan": _packed(self._from_above(step)),
                "forecast": _packed(_levels(step.forecast.probability)),
                "futures": self._futures().round(2).tolist(),
            }
        )

    def _from_above(self, step: Step) -> NDArray[np.uint8]:
        """The scan as a picture (P, P) on the place of the grid: nothing, ground or obstacle."""
        assert step.mapped is not None
        mapper, n = self.stream.mapper, FINER * self.stream.mapper.grid.cells
        points = transform(step.points, step.mapped.pose @ mapper.sensor_to_body)
        corner = step.mapped.centre_cell - mapper.grid.half - 0.5  # cell (i, j) is centred on (i, j)
        cells = np.floor(FINER * (mapper.grid.in_cells(points, self._origin) - corner)).astype(np.int64)
        picture = np.zeros((n, n), np.uint8)
        for code, chosen in ((GROUND, ~step.mapped.obstacle), (OBSTACLE, step.mapped.obstacle)):
            i, j = cells[chosen & ((cells >= 0) & (cells < n)).all(axis=1)].T
            picture[i, j] = code
        return picture

    @property
    def _origin(self) -> FloatArray:
        """World position (2,) of lattice cell (0, 0)."""
        assert self.stream.mapper.origin is not None  # a scan has given it
        return self.stream.mapper.origin

    def _futures(self) -> NDArray[np.float64]:
        """Where the ego may go (K, N, 2), in metres from the centre cell."""
        seen, options = self.stream.seen, self.stream.forecaster.hparams
        assert seen is not None
        poses, times = (np.asarray(values[0].cpu(), np.float64) for values in (seen["pose"], seen["time"]))
        motion: EgoMotion = getattr(self.stream.forecaster, "motion", EgoMotion())
        count, generator = options.get("futures", FUTURES), np.random.default_rng(options.get("seed", 0))
        resolution = float(seen["resolution"][0])
        found = ego_futures(poses, times, self.stream.horizons, count, generator, motion, resolution)
        centre = np.asarray(seen["centre_cell"][0, -1].cpu(), np.float64)
        return resolution * (found[..., :2] - centre)

    def write(self, file: Path) -> Path:
        """The page, whole or not at all."""
        data = {
            "cells": self.stream.mapper.grid.cells,
            "resolution": self.stream.mapper.grid.resolution,
            "finer": FINER,
            "levels": LEVELS,
            "period": self.stream.period,
            "horizons": self.stream.horizons,
            "grids": _packed(np.array(self._grids, np.uint8)),
            "places": self._places,
            "shown": [{**shown, **self._errors(n)} for n, shown in enumerate(self._shown)],
        }
        title = f"{self.name}: {self.what}"
        facts = (
            f"{len(self._grids)} scans, {len(self._shown)} of them with {self.stream.horizons} forecasts up to "
            f"{in_seconds(self.stream.horizons * self.stream.period)} ahead; cells of "
            f"{self.stream.mapper.grid.resolution:.2f} m; maps with east to the right and north up."
        )
        text = (files("envpred.live") / TEMPLATE).read_text(encoding="utf-8")
        for mark, value in (
            ("__TITLE__", html.escape(title)),
            ("__FACTS__", html.escape(facts)),
            ("__DATA__", json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")),
        ):
            text = text.replace(mark, value)
        file.parent.mkdir(parents=True, exist_ok=True)
        return replace_text(file, text)

    def _errors(self, n: int) -> dict[str, list[float | None]]:
        """Mean squared errors of a shown forecast and of the last frame by horizon; None where nothing came."""
        at = self._shown[n]["at"]
        known = [at + h for h in range(1, self.stream.horizons + 1)]
        known = [t if t < len(self._grids) and self._places[t][4] == self._places[at][4] else -1 for t in known]
        pairs = [(self._forecasts[n][h], self._exact[at], self._exact[t]) for h, t in enumerate(known) if t >= 0]
        missing: list[float | None] = [None] * known.count(-1)  # from the first on that is not known, none is
        return {
            "mse": [*(float(f"{np.mean((f - came) ** 2):.3g}") for f, _, came in pairs), *missing],
            "still": [*(float(f"{np.mean((last - came) ** 2):.3g}") for _, last, came in pairs), *missing],
        }


def _levels(probability: NDArray[np.floating]) -> NDArray[np.uint8]:
    levels: NDArray[np.uint8] = np.rint(np.clip(probability, 0, 1) * LEVELS).astype(np.uint8)
    return levels


def _packed(values: NDArray[np.uint8]) -> str:
    """Bytes as the page holds them: deflated, in base64."""
    return base64.b64encode(zlib.compress(np.ascontiguousarray(values).tobytes(), 9)).decode()
