"""The fixed frame: all frames of a window on the grid of the last one shown, so that what stands, stands still.

Grids share a lattice, so moving one into the frame of another, and back, is exact to the bit.
"""

from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from envpred.datamodules import Future, Seen
from envpred.mapping.ego_motion import EgoMotion, cells_of, centre_offset, ego_futures
from envpred.mapping.shift import placed

MARGIN = 8  # cells that are read around where future grids lie

Cells = NDArray[np.int64]


@dataclass(frozen=True)
class FixedFrame:
    """The judged grid of the last frame shown, wider by as much as the future grids go beyond it.

    Args:
        centre: (2,) lattice cell at the centre of that judged grid.
        cells: along a side of the judged grids.
        future: (N, 2) lattice cells at the centres of those that are forecast.
        before: (2,) cells that are added in the west and south.
        after: (2,) cells that are added in the east and north.
        empty: (C,) what the channels of a cell hold of which nothing is known.
    """

    centre: Cells
    cells: int
    future: Cells
    before: Cells
    after: Cells
    empty: Tensor

    @classmethod
    def of(cls, centre: Cells, cells: int, future: Cells, empty: Tensor, most: int, multiple: int) -> Self:
        """The frame that holds the future grids, as far as it may.

        Args:
            centre: of the judged grid of the last frame shown, as the others up to `empty`: see above.
            cells: of judged grids.
            future: centres of those that are forecast.
            empty: of channels.
            most: cells at most that are added on a side; 0 leaves the judged grid.
            multiple: of so many cells is what is added, for a network that halves its grid.
        """
        shift = future - centre
        needed = np.stack([-shift.min(axis=0), shift.max(axis=0)]).clip(0) + MARGIN
        before, after = np.minimum(-(-needed // multiple), most // multiple) * multiple
        return cls(centre, cells, future, before, after, empty)

    def first_cell(self, centre: Cells, cells: int) -> tuple[int, int]:
        """Where in this frame the first cell lies of a grid of `cells` whose centre lies at the lattice cell given."""
        i, j = self.before + centre - self.centre - (cells - self.cells) // 2
        return int(i), int(j)

    def filled(self, values: Tensor) -> Tensor:
        """Channels (C, H, W) of this frame that hold the same `values` (C,) everywhere."""
        height, width = (int(side) for side in self.cells + self.before + self.after)
        return values[:, None, None].expand(-1, height, width)

    def hold(self, grid: Tensor, centre: Cells, held: Tensor) -> Tensor:
        """`grid` (C, n, n) in this frame; cells outside of it keep what is `held` (C, H, W)."""
        return placed(grid, self.first_cell(centre, grid.shape[-1]), held)

    def back(self, channels: Tensor) -> Tensor:
        """Forecasts (N, C, H, W) in this frame, each on its future grid; cells that enter this frame are empty."""
        beyond = self.empty[:, None, None].expand(-1, self.cells, self.cells)
        corners = [self.first_cell(centre, self.cells) for centre in self.future]
        return torch.stack([placed(grid, (-i, -j), beyond) for grid, (i, j) in zip(channels, corners, strict=True)])


class Reading(NamedTuple):
    """What a network reads of windows, in the ego's frame of the time or, of a single window, in a fixed frame.

    Args:
        frames: (B, T, C, H, W) those shown, and those to come where they are known.
        judged: (B, T, 1, H, W) whether a cell lies in the judged grid of its frame; None if all do.
        frame: the fixed frame, if it is one.
    """

    frames: Tensor
    judged: Tensor | None = None
    frame: FixedFrame | None = None

    @classmethod
    def fixed(
        cls, seen: Seen, b: int, cells: Cells, empty: Tensor, multiple: int, future: Future | None = None
    ) -> Self:
        """Window `b` in the fixed frame of future grids at `cells` (N, 2); of the wide grid where it is seen.

        A cell that a frame does not show keeps what it held before, at first nothing.
        """
        grids, places = seen["frames"][b], seen["centre_cell"][b]
        if future is not None:
            grids, places = torch.cat([grids, future["frames"][b]]), torch.cat([places, future["centre_cell"][b]])
        centres, given, n = np.asarray(places.cpu(), np.int64), seen["frames"].shape[1], grids.shape[-1]
        wide = seen["context"][b] if "context" in seen else None
        most = 0 if wide is None else (wide.shape[-1] - n) // 2
        frame = FixedFrame.of(centres[given - 1], n, cells, empty, most, multiple)
        held, frames = frame.filled(empty), []
        for t, (grid, centre) in enumerate(zip(grids, centres, strict=True)):
            if wide is not None and t < given:
                held = frame.hold(wide[t], centre, held)
            held = frame.hold(grid, centre, held)
            frames.append(held)
        everywhere, nowhere = grids.new_ones(1, n, n).bool(), frame.filled(grids.new_zeros(1).bool())
        judged = torch.stack([frame.hold(everywhere, centre, nowhere) for centre in centres])
        return cls(torch.stack(frames)[None], judged[None], frame)

    def back(self, channels: Tensor) -> Tensor:
        """Forecasts (B, N, C, H, W) as the network makes them, in the ego's grid of each frame."""
        return channels if self.frame is None else self.frame.back(channels[0])[None]


def likeliest_cells(seen: Seen, b: int, horizons: int) -> Cells:
    """Lattice cells (horizons, 2) at the centres of window `b`'s future grids, by the ego's likeliest future."""
    pose, time = (np.asarray(value[b].cpu(), np.float64) for value in (seen["pose"], seen["time"]))
    centre = np.asarray(seen["centre_cell"][b].cpu(), np.int64)
    resolution, unused = float(seen["resolution"][b]), np.random.default_rng(0)
    (likeliest,) = ego_futures(pose, time, horizons, 1, unused, EgoMotion(), resolution)
    return cells_of(likeliest) + centre_offset(centre, pose)
