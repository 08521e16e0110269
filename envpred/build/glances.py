"""What the mapping made of a drive is looked at: warnings where hardly anything is known, or no ground was found."""

import numpy as np
from numpy.typing import NDArray

from envpred.mapping.geometry import UNKNOWN
from envpred.mapping.mapper import Mapped

ODD_UNKNOWN = 0.95  # share of cells
ODD_GROUND = 0.5  # metres by which the ground may miss the height that the sensor is said to have
LOOKS = 8  # frames of a drive in which the ground is looked for
NEAR = 10.0  # metres around the sensor in which it is looked for


class Glances:
    """Looks at what the mapping makes of a drive's frames: the share of unknown cells, and where the ground lies.

    Args:
        frames: number of frames that will be shown.
        sensor_height: of the sensor above the road, in metres.
    """

    def __init__(self, frames: int, sensor_height: float) -> None:
        self.sensor_height, self.every, self.seen = sensor_height, max(1, -(-frames // LOOKS)), 0
        self.unknown = 0.0
        self.heights: list[float] = []  # of the ground in the sensor frame; not a number where none was found

    def look(self, points: NDArray[np.float32], mapped: Mapped) -> None:
        """Look at the next frame."""
        self.unknown += 1 - np.count_nonzero(mapped.label != UNKNOWN) / mapped.label.size
        if self.seen % self.every == 0:
            x, y, z = points[::4, :3].T  # a quarter tells it as well
            near = (np.abs(x) < NEAR) & (np.abs(y) < NEAR) & (z < 0) & ~mapped.obstacle[::4]
            self.heights.append(float(np.median(z[near])) if near.any() else np.nan)
        self.seen += 1

    def oddities(self, name: str) -> list[str]:
        """What is odd about them in the drive of that `name`, a line each."""
        told, heights = [], np.array(self.heights)
        unknown = self.unknown / max(self.seen, 1)
        if unknown > ODD_UNKNOWN:
            told.append(f"{name}: {unknown:.1%} of the cells are unknown on average; look at a scan and its pose")
        without = float(np.isnan(heights).mean()) if len(heights) else 0.0
        if without > 0.5:
            told.append(f"{name}: no ground within {NEAR:.0f} m in {without:.0%} of the scans looked at")
        elif len(heights) and abs(np.nanmedian(heights) + self.sensor_height) > ODD_GROUND:
            told.append(
                f"{name}: the ground lies {-np.nanmedian(heights):.2f} m below the sensor, which is said to be "
                f"{self.sensor_height:.2f} m above it"
            )
        return told
