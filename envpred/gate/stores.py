"""What grids, velocities and simulated drives leave on the disk."""

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from msgspec import Meta, Struct

from envpred.gate.arrays import ArraySchema
from envpred.gate.types import Cells, Checksum, Count, Key, Length, Line, Number, Place, Point, Positive, Row

# Axes of the stored arrays: T frames, H cells of the judged grid's side, W of the wide one's; other names are free.
AXES: dict[str, tuple[str, tuple[int | str, ...]]] = {
    "label": ("u", ("T", "H", "H")),
    "evidence": ("f", ("T", 2, "H", "H")),
    "centre_cell": ("i", ("T", 2)),
    "pose": ("f", ("T", 4, 4)),
    "time": ("f", ("T",)),
    "context_label": ("u", ("T", "W", "W")),
    "context_evidence": ("f", ("T", 2, "W", "W")),
    "velocity": ("f", ("T", 2, "H", "H")),
    "velocity_cov": ("f", ("T", 3, "H", "H")),
    "particle_forecast": ("u", ("T", "horizons", "H", "H")),
    "moving": ("u", ("T", "H", "H")),
}


class Lattice(Struct):
    """Where grids lie: the world position of cell (0, 0), side of a cell in metres, cells of both grids' sides."""

    origin: Point
    resolution: Length
    cells: Cells
    context: Cells | None = None


class CarBody(Struct):
    """The ego's body in the sensor frame, in metres."""

    rear: Number
    front: Number
    half_width: Positive

    def __post_init__(self) -> None:
        if not self.rear < self.front:
            raise ValueError("the rear is not behind the front")


class ArrayEntry(Struct):
    """An array of a drive."""

    file: Place
    dtype: Annotated[str, Meta(pattern=r"\A[<>|=]?[fiub][1248]\Z")]
    shape: Annotated[list[Count], Meta(min_length=1, max_length=8)]
    checksum: Checksum
    group: Key


class Manifest(Struct):
    """`manifest.json` of a drive of a store."""

    frames: Annotated[list[Count], Meta(min_length=1)]
    stretches: list[tuple[Count, Count]]
    lattice: Lattice
    period: Length
    sensor: tuple[Row, Row, Row, Row]
    body: CarBody
    groups: dict[Key, Line]
    arrays: dict[Key, ArrayEntry]
    warnings: list[Line] = []

    def __post_init__(self) -> None:
        if any(b <= a for a, b in itertools.pairwise(self.frames)):
            raise ValueError("frames do not increase")
        ends = [0, *(first + length for first, length in self.stretches)]
        starts = [*(first for first, _ in self.stretches), len(self.frames)]
        if any(start < end for start, end in zip(starts, ends, strict=True)) or 0 in (n for _, n in self.stretches):
            raise ValueError("stretches do not fit the frames")
        for name, entry in self.arrays.items():
            self._check(name, entry)

    def _check(self, name: str, entry: ArrayEntry) -> None:
        if entry.group not in self.groups:
            raise ValueError(f"{name} is of a group that is not there")
        kind, axes = AXES.get(name, ("", ()))
        sizes = {"T": len(self.frames), "H": self.lattice.cells, "W": self.lattice.context}
        asked = [sizes.get(axis) if isinstance(axis, str) else axis for axis in axes] or [sizes["T"]]
        lengths = entry.shape if axes else entry.shape[:1]
        fits = len(lengths) == len(asked) and all(b in (None, a) for a, b in zip(lengths, asked, strict=True))
        if not fits or kind not in entry.dtype:
            raise ValueError(f"{name} of {entry.dtype}{tuple(entry.shape)} does not fit frames and lattice")


class GroupEntry(Struct):
    """What a group of arrays of a store was made with."""

    hash: Line
    parameters: dict[str, Any]
    before: dict[Line, dict[str, Any]] = {}  # those that drives may still have


class Index(Struct):
    """`store.json`."""

    groups: dict[Key, GroupEntry]


Checked = dict[Line, tuple[Count, int, Checksum]]  # `.checked.json`: size, time of change and checksum by place


class Asked(Struct):
    """`simulated.json`: what all drives of a folder are made from."""

    frames: Count
    seed: Count
    beams: Count
    recording: Line
    mix: Line
    swept: bool = False


def recording(names: Sequence[str]) -> Mapping[str, ArraySchema]:
    """The arrays of a recording of traffic of as many towns as the `names` begin with numbers."""
    towns = sorted({name.split("/")[0] for name in names if "/" in name})
    arrays = {
        "version": ArraySchema("iu", ()),
        "interval": ArraySchema("fiu", (), 1e-3, 60),
        "seconds": ArraySchema("fiu", (), 0, 1e6),
        "names": ArraySchema("U", (len(towns),)),
    }
    for k in range(len(towns)):
        for what in ("lane", "junction", "track"):
            arrays |= {
                f"{k}/{what}_count": ArraySchema("iu", (f"{k}{what}",), 1, 1e6),
                f"{k}/{what}_first": ArraySchema("iu", (f"{k}{what}", 2), -1e9, 1e9),
                f"{k}/{what}_bends": ArraySchema("iu", (2, f"{k}{what} points"), -1e9, 1e9),
            }
        arrays |= {
            f"{k}/lane_kind": ArraySchema("u", (f"{k}lane",)),
            f"{k}/lane_width": ArraySchema("f", (f"{k}lane",), 0, 1e3),
            f"{k}/track_start": ArraySchema("iu", (f"{k}track",), 0, 1e6),
            f"{k}/track_table": ArraySchema("f", (f"{k}track", 4), -math.inf, 1e3),
        }
    return arrays
