"""Windows of consecutive grids: what a forecaster is given, and which ones there are."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, TypedDict

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import Dataset, Sampler

from envpred.datamodules import symmetry as turning
from envpred.datamodules.selection import Selection
from envpred.datamodules.variants import Variant
from envpred.mapping.evidence import pignistic
from envpred.mapping.geometry import heading_of
from envpred.store import StoredDrive


class Window(TypedDict):
    """One window of T frames; a batch of them has a leading axis B, and lists of `drive`."""

    frames: Tensor  # (T, C, H, W) the variant's channels
    occupancy: Tensor  # (T, H, W) the probability of occupied that is judged
    centre_cell: Tensor  # (T, 2) where each grid lies on the drive's lattice
    pose: Tensor  # (T, 3) x and y in cells of that lattice, heading in radians
    drive: str
    start: int  # position of the first frame in the drive's arrays
    index: int  # place of the window in its data set, by which metrics tell duplicates
    extra: Tensor  # (..., H, W) the stored array that a forecaster asks for, at the last frame shown; else empty


class WindowBatch(TypedDict):
    """A batch of windows as the default collate makes it."""

    frames: Tensor  # (B, T, C, H, W)
    occupancy: Tensor  # (B, T, H, W)
    centre_cell: Tensor  # (B, T, 2)
    pose: Tensor  # (B, T, 3)
    drive: list[str]
    start: Tensor  # (B,)
    index: Tensor  # (B,)
    extra: Tensor  # (B, ..., H, W)


@dataclass(frozen=True)
class Place:
    """Where a window lies."""

    drive: StoredDrive
    start: int


@dataclass(frozen=True)
class Draw:
    """A training window as it is drawn: which one, how it is turned, and where the part begins that is cut out."""

    index: int
    symmetry: int = 0
    corner: tuple[int, int] = (0, 0)


class WindowDataset(Dataset[Window]):
    """The windows at `places`, each read from the disk when it is asked for, by its index or as a `Draw`.

    With `crop` an item is a square of so many cells a side, the same of every frame.
    """

    def __init__(
        self,
        places: list[Place],
        variant: Variant,
        length: int,
        given: int = 1,
        extra: str | None = None,
        crop: int | None = None,
    ) -> None:
        self.places, self.variant, self.length, self.given, self.extra = places, variant, length, given, extra
        self.crop = crop

    def __len__(self) -> int:
        return len(self.places)

    def __getitem__(self, item: int | Draw) -> Window:
        drawn = item if isinstance(item, Draw) else Draw(item)
        place, symmetry = self.places[drawn.index], drawn.symmetry
        drive, cut = place.drive, slice(place.start, place.start + self.length)
        # Copies: a mapped array held on to would keep its pages in memory.
        arrays = {n: _in_float32(np.array(drive.array(n)[cut])) for n in {*self.variant.arrays, "evidence"}}
        frames, occupancy = self.variant.view(arrays), pignistic(arrays["evidence"])
        poses = np.array(drive.array("pose")[cut])
        resolution = drive.manifest["lattice"]["resolution"]
        cells = (poses[:, :2, 3] - drive.origin) / resolution
        pose = np.concatenate([cells, heading_of(poses)[:, None]], axis=1)
        centre_cell = np.array(drive.array("centre_cell")[cut])
        extra = np.empty(0, np.uint8)
        if self.extra is not None:
            extra = np.array(drive.array(self.extra)[place.start + self.given - 1])
        if symmetry:
            frames, occupancy = turning.turn_grid(frames, symmetry), turning.turn_grid(occupancy, symmetry)
            centre_cell, pose = turning.turn_cell(centre_cell, symmetry), turning.turn_pose(pose, symmetry)
            if self.variant.velocity is not None:
                channels = list(self.variant.velocity)
                frames = frames.copy()
                frames[:, channels] = np.moveaxis(
                    turning.turn_vector(np.moveaxis(frames[:, channels], 1, -1), symmetry), -1, 1
                )
        if self.crop is not None:
            west, south = drawn.corner
            shift = np.array([west, south]) + self.crop // 2 - occupancy.shape[-1] // 2
            cut_out = (..., slice(west, west + self.crop), slice(south, south + self.crop))
            frames, occupancy, centre_cell = frames[cut_out], occupancy[cut_out], centre_cell + shift
        return Window(
            frames=torch.from_numpy(np.ascontiguousarray(frames)),
            occupancy=torch.from_numpy(np.ascontiguousarray(occupancy)),
            centre_cell=torch.from_numpy(np.ascontiguousarray(centre_cell)),
            pose=torch.from_numpy(pose.astype(np.float32)),
            drive=drive.name,
            start=place.start,
            index=drawn.index,
            extra=torch.from_numpy(np.ascontiguousarray(extra)),
        )


def _in_float32(grids: NDArray[Any]) -> NDArray[np.float32]:
    """The same numbers; torch converts halves about twenty times as fast as NumPy."""
    return np.asarray(torch.from_numpy(grids).float().numpy(), np.float32)


def every_window(selections: list[Selection], length: int) -> list[Place]:
    """All windows of `length` frames without a gap, one a start."""
    return [Place(s.drive, a + k) for s in selections for a, n in s.stretches() for k in range(n - length + 1)]


def windows_in_order(selections: list[Selection], length: int) -> list[Place]:
    """Windows that follow each other without overlap from the start of every stretch, so that a frame counts once."""
    return [
        Place(s.drive, a + k) for s in selections for a, n in s.stretches() for k in range(0, n - length + 1, length)
    ]


class RandomWindows(Sampler[Draw]):
    """Draws `samples` windows an epoch with replacement, each with a symmetry and a part of the grid if asked for.

    What an epoch draws depends on the seed and the epoch's number alone, so a resumed run draws what the uninterrupted
    one would have drawn.

    Args:
        windows: how many there are.
        samples: how many are drawn.
        seed: of what is drawn.
        augment: draw a symmetry too.
        epoch: tells the number of the current epoch.
        spare: cells by which the grid is larger than the part that is cut out.
    """

    def __init__(
        self, windows: int, samples: int, seed: int, augment: bool, epoch: Callable[[], int], spare: int = 0
    ) -> None:
        self.windows, self.samples, self.seed, self.augment = windows, samples, seed, augment
        self.epoch, self.spare = epoch, spare

    def __len__(self) -> int:
        return self.samples

    def __iter__(self) -> Iterator[Draw]:
        random = np.random.default_rng([self.seed, self.epoch()])
        index = random.integers(self.windows, size=self.samples).tolist()
        turn = random.integers(turning.COUNT if self.augment else 1, size=self.samples).tolist()
        corner = random.integers(self.spare + 1, size=(self.samples, 2)).tolist()
        return iter([Draw(i, s, (a, b)) for i, s, (a, b) in zip(index, turn, corner, strict=True)])
