"""A made-up window: what tests of scenes and of their pictures share."""

from typing import Any

import numpy as np

from envpred.results.scenes import Scene

CELLS, FRAMES = 64, 12


def window() -> tuple[np.ndarray, np.ndarray]:
    """The ego drives 2 cells a frame east past a wall; a car, 3 x 3 cells, drives 3 cells a frame north."""
    world = np.full((FRAMES, 160, 160), 0.05, np.float32)
    world[:, 20:150, 100:102] = 0.95
    centre_cell = np.array([[50 + 2 * t, 80] for t in range(FRAMES)])
    for t in range(FRAMES):
        world[t, 76:79, 55 + 3 * t : 58 + 3 * t] = 0.95
        world[t, 48 + 2 * t : 52 + 2 * t, 79:82] = 0.95  # the ego itself
    half = CELLS // 2
    grids = [world[t, i - half : i + half, j - half : j + half] for t, (i, j) in enumerate(centre_cell)]
    return np.stack(grids), centre_cell


def scene(seen: int = 4, forecasts: int = 8, **options: Any) -> Scene:
    """The window as it was seen, and the last frame that was seen as its forecast."""
    occupancy, centre_cell = window()
    shown = tuple(range(30, 30 + seen))
    static = np.repeat(occupancy[seen - 1 : seen], forecasts, axis=0)
    facts: dict[str, Any] = {"resolution": 1 / 3, "period": 0.1} | options
    return Scene("a_drive", shown, occupancy[:seen], occupancy[seen:], centre_cell, {"static": static}, **facts)
