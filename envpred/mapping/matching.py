"""Velocities by matching: where what is seen around a place now was seen some frames ago.

A laser grid measures no velocity, so in the filter of Nuss et al. only the border of a body tells particles apart:
inside it, every velocity survives that does not leave it for long.  But a body is rigid.  Shifting the grid of some
frames ago by the right displacement makes it agree with the present one around the body, its borders included, and how
well other displacements agree says how likely they are.  The filter takes this for its measurement of velocities, in
the place where that of Nuss et al. takes a radar's.
"""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, conv2d, max_pool2d, pad

from envpred.mapping.geometry import GridSpec
from envpred.mapping.particle_state import ParticleFilterParameters

# For cells of a third of a metre, in which a car is 12 x 6 and moves up to 5 a frame.
TILE = 4  # cells of a side of the squares that share a measurement
WINDOW = 16  # cells of a side of what is matched around each
MARGIN = (WINDOW - TILE) // 2
BORDER = 2  # cells around a body that are matched with it: what is free there tells where it ends
CHANGED = 0.25  # a cell has changed if the product of what it was and is lies below minus this


@dataclass(frozen=True)
class Matches:
    """How well the displacements agree around the places where something has moved.

    Args:
        tile: (H, W) int64, which of the n surfaces a cell's particles read, -1 where nothing has moved.
        score: (n, 2S+1, 2S+1) agreement of the displacement (east, north) by -S ... S cells, in cells.
        cells_per_velocity: displacement in cells of 1 m/s.
    """

    tile: Tensor
    score: Tensor
    cells_per_velocity: float

    def log_likelihood(self, velocity: Tensor, tile: Tensor) -> Tensor:
        """Agreement (M,) of each `velocity` (2, M) in m/s with surface `tile` (M,), less that of the best displacement.

        Bilinear between displacements by whole cells; faster velocities count as the fastest that is tried.
        """
        size = self.score.shape[-1]
        place = velocity.mul(self.cells_per_velocity).add_(size // 2).clamp_(0, size - 1.001)
        corner = place.int()
        (x, y), (i, j) = place - corner, corner
        flat, first = (self.score - self.score.amax((1, 2), keepdim=True)).flatten(), (tile * size + i) * size + j
        near = flat.index_select(0, first).lerp(flat.index_select(0, first + size), x)
        far = flat.index_select(0, first + 1).lerp(flat.index_select(0, first + size + 1), x)
        return near.lerp(far, y)


def match(now: Tensor, then: Tensor, parameters: ParticleFilterParameters, grid: GridSpec) -> Matches:
    """Compare two grids (H, W) of m(O) - m(F) on the same cells, `parameters.matching` frames apart."""
    changed = now * then < -CHANGED
    rows, columns = (-(-n // TILE) for n in now.shape)
    room = (0, columns * TILE - now.shape[1], 0, rows * TILE - now.shape[0])  # to whole tiles
    seconds = parameters.matching * parameters.period
    reach = 1 + int(parameters.matching_fastest * seconds / grid.resolution)

    # Each changed cell that comes to agree adds 2: where there are few, nothing can be won over standing still.
    around = avg_pool2d(_framed(changed.float(), room, MARGIN)[None], (WINDOW, 1), (TILE, 1))
    around = avg_pool2d(around, (1, WINDOW), (1, TILE))[0] * (2 * WINDOW**2)
    holds = max_pool2d(pad(now, room)[None], TILE)[0] > 0
    tiles = (holds & (around > parameters.matching_gain)).nonzero()

    number = torch.full((rows, columns), -1, device=now.device)
    if not len(tiles):
        return Matches(number[:1, :1].expand(now.shape), now.new_zeros(0, 1, 1), seconds / grid.resolution)

    window = _around(now, tiles, room, WINDOW, MARGIN)
    window = window * _body(window > 0)
    before = _around(then, tiles, room, WINDOW + 2 * reach, MARGIN + reach)
    # Shifting the past by +s reads it at -s.
    score = conv2d(before[None], window[:, None], groups=len(tiles))[0].flip(1, 2)
    still = score[:, reach - 1 : reach + 2, reach - 1 : reach + 2].amax((1, 2))
    moved = (score.amax((1, 2)) - still > parameters.matching_gain).nonzero().squeeze(1)
    score = score.index_select(0, moved)

    number[tuple(tiles.index_select(0, moved).T)] = torch.arange(len(moved), device=now.device)
    tile = number.repeat_interleave(TILE, 0).repeat_interleave(TILE, 1)[: now.shape[0], : now.shape[1]]
    return Matches(tile, score, seconds / grid.resolution)


def _body(occupied: Tensor) -> Tensor:
    """The cells (n, WINDOW, WINDOW) of what is connected with the tile in the middle, and around it; 0 or 1."""
    occupied = occupied.float()
    body = torch.zeros_like(occupied)
    middle = slice(MARGIN, MARGIN + TILE)
    body[:, middle, middle] = occupied[:, middle, middle]
    for _ in range(MARGIN):
        body = max_pool2d(body, 3, 1, 1) * occupied
    return max_pool2d(body, 2 * BORDER + 1, 1, BORDER)


def _framed(field: Tensor, room: tuple[int, ...], margin: int) -> Tensor:
    """`field` (H, W) filled up to whole tiles, with a margin of zeros."""
    return pad(field, tuple(n + margin for n in room))


def _around(field: Tensor, tiles: Tensor, room: tuple[int, ...], size: int, margin: int) -> Tensor:
    """The squares (n, size, size) of `field` (H, W) around `tiles` (n, 2)."""
    windows = _framed(field, room, margin).unfold(0, size, TILE).unfold(1, size, TILE)
    return windows[tiles[:, 0], tiles[:, 1]]
