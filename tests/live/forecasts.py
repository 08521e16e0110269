"""Forecasts drawn by hand, on cells of a metre, a second apart."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from envpred.live.placed import PlacedForecast

HOME = np.array([20.0, 15.0, 0.0])  # where the ego stands, in cells and so in metres
LANE = 20  # northing of the lane that paths take, beyond the cells that are the ego's
BODY = (-1.0, 1.0, 0.5)  # two metres long, one wide


def empty(horizons: int, cells: int = 16) -> NDArray[np.float32]:
    """Grids (horizons, cells, cells) in which everything is free."""
    return np.zeros((horizons, cells, cells), np.float32)


def cell(x: int, y: int = LANE) -> tuple[int, int]:
    """Where the lattice cell (x, y) lies in such grids around `HOME`."""
    return x - 20 + 8, y - 15 + 8


def standing(probability: NDArray[np.float32], **fields: Any) -> PlacedForecast:
    """A forecast for an ego that stands at `HOME`; all of the present is free, and known up to 24 m away."""
    given: dict[str, Any] = {
        "probability": probability,
        "ego": np.tile(HOME, (len(probability), 1)),
        "present": empty(1, 48)[0],
        "known": np.ones((48, 48), np.bool_),
        "now": HOME,
        "sensor": (0.0, 0.0, 0.0),
        "body": BODY,
        "origin": (0.0, 0.0),
        "resolution": 1.0,
        "period": 1.0,
    }
    return PlacedForecast(**(given | fields))
