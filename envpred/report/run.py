"""A test run as its result file tells it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envpred.metrics.about import About

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Measured:
    """A metric of a run: `mean` and `standard_error` (N,), `per_window` (W, N) or None; NaN where undefined.

    `standard_error` counts windows as independent; `drive_error` (N,) counts drives, None without values by window.
    `about` says how it is written.
    """

    mean: FloatArray
    standard_error: FloatArray
    per_window: FloatArray | None
    about: About
    drive_error: FloatArray | None = None


@dataclass(frozen=True)
class Run:
    """One test run, as its result file tells it.

    Args:
        file: the result.
        method: what people call it.
        label: names the run within a report: the method, and what tells it from others of that name.
        name: of the model.
        role: what kind of forecaster it is: `static`, `moved`, `particle`, `rollout`, `oracle` or `learned`.
        variant: of its input.
        horizon_s: the horizons (N,) in seconds.
        metrics: those with a value per horizon, by their key.
        reliability: the reliability diagram (N, bins), if there is one.
        data: what it was measured on.
        record: the whole result.
        seeds: how many it is the mean of.
    """

    file: Path
    method: str
    label: str
    name: str
    role: str
    variant: str
    horizon_s: FloatArray
    metrics: dict[str, Measured]
    reliability: dict[str, FloatArray] | None
    data: dict[str, Any]
    record: dict[str, Any]
    seeds: int = 1

    @property
    def mse(self) -> Measured:
        """The mean squared error, which every result has."""
        return self.metrics["mse"]

    @property
    def drives(self) -> list[str]:
        """The drive of each window."""
        return [str(drive) for drive, _ in self.data["windows"]]

    @property
    def is_oracle(self) -> bool:
        """Whether it reads the future."""
        return self.role == "oracle"
