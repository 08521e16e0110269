"""Windows of consecutive grids, read from a store: what a forecaster sees, and apart from it what came then."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypedDict, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import Dataset, Sampler, default_collate

from envpred.datamodules import symmetry as turning
from envpred.datamodules.contract import Future, Needs, Seen, WindowBatch
from envpred.datamodules.selection import Selection
from envpred.datamodules.transform import KINDS, Transform
from envpred.datamodules.variants import Variant
from envpred.mapping.evidence import pignistic
from envpred.mapping.geometry import FloatArray, heading_of
from envpred.store import StoredDrive

CONTEXT = "context_"  # what the names of arrays on the wide grid begin with
FUTURE = ("frames", "occupancy", "occupied_mass", "label", "centre_cell", "pose")


class Window(TypedDict):
    """One window, as `WindowBatch` without the axis B."""

    seen: Seen
    future: Future | None
    drive: str
    start: int
    index: int


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

    Args:
        places: the windows.
        variant: channels of their frames.
        given: frames shown.
        horizons: frames that are to be forecast; 0 where there are no targets.
        needs: what is read beside the variant.
        crop: cut out a square of so many cells a side, the same of every frame.
        stride: take every so many-th frame.
        tracked: tell what moves in the frames to be forecast, by boxes of tracked objects.
    """

    def __init__(
        self,
        places: list[Place],
        variant: Variant,
        given: int,
        horizons: int,
        needs: Needs | None = None,
        crop: int | None = None,
        stride: int = 1,
        tracked: bool = False,
    ) -> None:
        self.places, self.variant, self.given, self.horizons = places, variant, given, horizons
        self.needs, self.crop, self.stride, self.tracked = needs or Needs(), crop, stride, tracked

    def __len__(self) -> int:
        return len(self.places)

    def __getitem__(self, item: int | Draw) -> Window:
        drawn = item if isinstance(item, Draw) else Draw(item)
        place = self.places[drawn.index]
        drive, given = place.drive, self.given
        transform = Transform(drive.grid.cells, drawn.symmetry, self.crop, drawn.corner)
        whole = self._judged(place, transform)
        seen: dict[str, Any] = {name: _tensor(field[:given]) for name, field in whole.items()}
        seen["arrays"] = {
            name: _tensor(transform.stored(self._read(place, name), KINDS.get(name, "grid")))
            for name in self.needs.arrays
        }
        seen |= self._car(drive, transform)
        if self.needs.context:
            seen |= self._context(place, transform)
        future = {name: _tensor(whole[name][given:]) for name in FUTURE} if self.horizons else None
        if self.tracked and future is not None:
            moving = self._read(place, "moving", given + self.horizons)[given:]
            future["moving"] = _tensor(transform.stored(moving))
        if self.needs.future_pose and future is not None:
            seen |= {f"future_{name}": future[name].clone() for name in ("pose", "centre_cell")}
        return Window(
            seen=cast(Seen, seen),
            future=cast(Future, future) if future is not None else None,
            drive=drive.name,
            start=place.start,
            index=drawn.index,
        )

    def _judged(self, place: Place, transform: Transform) -> dict[str, NDArray[Any]]:
        """Frames shown and those to come, of the judged grid."""
        drive, frames = place.drive, self.given + self.horizons
        arrays = {n: _in_float32(self._read(place, n, frames)) for n in {*self.variant.arrays, "evidence"}}
        poses, time = self._read(place, "pose", frames), self._read(place, "time", frames)
        cells = drive.grid.in_cells(poses[:, :2, 3], drive.origin)
        return {
            "frames": transform.frames(self.variant.make_frames(arrays), self.variant.vectors),
            "occupancy": transform.stored(pignistic(arrays["evidence"])),
            "occupied_mass": transform.stored(arrays["evidence"][:, 0]),
            "label": transform.stored(self._read(place, "label", frames)),
            "centre_cell": transform.centre_cell(self._read(place, "centre_cell", frames)),
            "pose": transform.pose(np.concatenate([cells, heading_of(poses)[:, None]], axis=1)),
            "time": time - time[self.given - 1],
        }

    def _context(self, place: Place, transform: Transform) -> dict[str, Tensor]:
        """The frames shown of the wide grid."""
        label = self._read(place, f"{CONTEXT}label")
        arrays = {name: self._on_context(place, name, label.shape[-1]) for name in self.variant.arrays}
        frames = transform.frames(self.variant.make_frames(arrays), self.variant.vectors)
        return {"context": _tensor(frames), "context_label": _tensor(transform.stored(label))}

    def _on_context(self, place: Place, name: str, cells: int) -> NDArray[np.float32]:
        """The array `name` on the wide grid; of what is stored for the judged grid alone, nothing is known beyond."""
        if place.drive.has(f"{CONTEXT}{name}"):
            return _in_float32(self._read(place, f"{CONTEXT}{name}"))
        return widened(_in_float32(self._read(place, name)), cells)

    def _read(self, place: Place, name: str, frames: int | None = None) -> NDArray[Any]:
        """A stored array over so many frames of the window, by default those shown.

        A copy: a mapped array held on to would keep its pages in memory.
        """
        count = self.given if frames is None else frames
        stop = place.start + (count - 1) * self.stride + 1
        return np.array(place.drive.array(name)[place.start : stop : self.stride])

    def _car(self, drive: StoredDrive, transform: Transform) -> dict[str, Tensor]:
        """The car and the grid: what is the same in all frames of a drive."""
        body = drive.body
        values = {
            "sensor": transform.in_body(pose_of(drive.sensor_to_body)),
            "body": np.array([body.rear, body.front, body.half_width]),
            "resolution": np.array(drive.grid.resolution),
            "period": np.array(drive.period * self.stride),
        }
        return {name: _tensor(value) for name, value in values.items()}


def collate(windows: Sequence[Window]) -> WindowBatch:
    """A batch of `windows`, which have targets all or none; a copy: what is seen shares no memory with the rest."""
    if windows[0]["future"] is None:
        return cast(WindowBatch, default_collate([_without_future(window) for window in windows]) | {"future": None})
    return cast(WindowBatch, default_collate(list(windows)))


def occupancy_of(window: Window) -> NDArray[np.float32]:
    """The probability of occupied (T, H, W) of all frames of a window."""
    future = window["future"]
    parts = [window["seen"]["occupancy"], *([future["occupancy"]] if future is not None else [])]
    return np.concatenate([part.numpy() for part in parts])


def pose_of(transform: FloatArray) -> FloatArray:
    """The pose (3,) in the plane, x, y and heading, of a rigid transform (4, 4) with x forward."""
    return np.array([*transform[:2, 3], heading_of(transform)])


def _without_future(window: Window) -> dict[str, Any]:
    return {name: value for name, value in window.items() if name != "future"}


def _tensor(array: NDArray[Any]) -> Tensor:
    """A tensor of the array, in single precision at most; it may share memory with it until windows are collated."""
    return torch.from_numpy(np.asarray(array, np.float32 if array.dtype == np.float64 else None, order="C"))


def widened(judged: NDArray[np.float32], cells: int) -> NDArray[np.float32]:
    """An array (..., H, W) of the judged grid in the middle of a grid of `cells`, with zeros around it."""
    margin = (cells - judged.shape[-1]) // 2
    return np.pad(judged, [(0, 0)] * (judged.ndim - 2) + [(margin, margin)] * 2)


def _in_float32(grids: NDArray[Any]) -> NDArray[np.float32]:
    """The same numbers; torch converts halves about twenty times as fast as NumPy."""
    return np.asarray(torch.from_numpy(grids).float().numpy(), np.float32)


def every_window(selections: list[Selection], length: int, stride: int = 1) -> list[Place]:
    """All windows of `length` frames, `stride` apart, without a gap, one a start."""
    span = (length - 1) * stride + 1
    return [Place(s.drive, a + k) for s in selections for a, n in s.stretches() for k in range(n - span + 1)]


def windows_in_order(selections: list[Selection], length: int, stride: int = 1) -> list[Place]:
    """Windows that follow each other without overlap from the start of every stretch, so that a frame counts once."""
    span = (length - 1) * stride + 1
    step = length * stride
    return [Place(s.drive, a + k) for s in selections for a, n in s.stretches() for k in range(0, n - span + 1, step)]


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
