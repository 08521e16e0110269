"""Scans as others write them: `.bin`, `.npy`, `.pcd` and `.ply` files, as columns by name.

Headers are compared with the size of their file before anything is allocated.
"""

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envpred.errors import UserError, one_line, printable
from envpred.gate import ArraySchema, read_array
from envpred.gate.arrays import DAMAGED

MOST_POINTS = 10_000_000  # of a scan: forty times as many as the finest scanners make
HEADER = 1 << 16  # bytes in which a header ends
KITTI = ("x", "y", "z", "intensity")
AGAIN = "copy it again, or delete it to leave a gap in the drive"
LEAST_BYTES = {"ascii": 2}  # of a number in a text: a digit and a space

Columns = dict[str, NDArray[Any]]


def read_cloud(file: Path, columns: list[str] | None = None) -> Columns:
    """The columns of one scan by name, of one length.

    Args:
        file: its ending says its format.
        columns: names of those of `.bin` (float32) and `.npy`, which name none; by default x, y, z and intensity.

    Raises:
        UserError: naming the file and what is wrong: missing, cut short, damaged, too large, or without x, y, z.
    """
    try:
        found = READERS[file.suffix](file, columns)
    except OSError as error:
        raise UserError(f"{file}: cannot be read ({error.strerror or one_line(error)}); {AGAIN}") from None
    except DAMAGED as error:
        raise UserError(f"{file}: damaged, or no scan ({one_line(error)}); {AGAIN}") from None
    for axis in "xyz":
        if axis not in found:
            names = printable(", ".join(found))
            raise UserError(f"{file}: has no column {axis}, only {names}; name its columns in `scans: columns`")
    return found


def _bin(file: Path, columns: list[str] | None) -> Columns:
    names = columns or KITTI
    size, row = file.stat().st_size, 4 * len(names)
    if size % row or size // row > MOST_POINTS:
        raise UserError(
            f"{file}: {size} bytes are no whole number of points of {row} bytes; name its columns in `scans: columns`, "
            "or copy it again"
        )
    return _by_name(np.fromfile(file, "<f4").reshape(-1, len(names)), names)


def _npy(file: Path, columns: list[str] | None) -> Columns:
    points = read_array(file, ArraySchema("f", ("points", "columns"), finite=False), AGAIN)
    names = columns or KITTI[: points.shape[1]]
    if points.shape[1] < 3 or (columns and points.shape[1] != len(columns)):
        raise UserError(
            f"{file}: an array of {points.shape[1]} columns, where {', '.join(names)} are named; name its columns in "
            "`scans: columns`"
        )
    return _by_name(points[:, : len(names)], names)


def _by_name(points: NDArray[Any], names: tuple[str, ...] | list[str]) -> Columns:
    return dict(zip(names, points.T, strict=True))


def _pcd(file: Path, columns: list[str] | None) -> Columns:
    _check_pcd(file)
    from pypcd4.pypcd4 import PointCloud

    cloud = PointCloud.from_path(file)
    if len(cloud.pc_data) != cloud.metadata.points:
        raise ValueError(f"{len(cloud.pc_data)} points where its header says {cloud.metadata.points}")
    return {name: np.atleast_1d(cloud.pc_data[name]) for name in cloud.pc_data.dtype.names or ()}


def _check_pcd(file: Path) -> None:
    """Refuse a header that says more than the file holds, or than a scan can have."""
    head, rest, size = _header(file, rb"^DATA[ \t]+(\w+)[ \t]*\r?\n")
    said = {words[0]: words[1:] for line in head.splitlines() if (words := line.split())}
    sizes, counts = ([int(word) for word in said[key]] for key in ("SIZE", "COUNT"))
    points = int(said["POINTS"][0])
    if not (len(sizes) == len(counts) == len(said["FIELDS"]) == len(said["TYPE"])) or not 0 < sum(counts) <= 1000:
        raise ValueError("FIELDS, SIZE, TYPE and COUNT do not fit together")
    if min(counts) < 1 or not all(1 <= n <= 8 for n in sizes) or not 0 <= points <= MOST_POINTS:
        raise ValueError(f"a header of {points} points")
    if points != math.prod(int(said[key][0]) for key in ("WIDTH", "HEIGHT")):
        raise ValueError("POINTS is not WIDTH times HEIGHT")
    row, kind = sum(a * b for a, b in zip(sizes, counts, strict=True)), said["DATA"][0].lower()
    if kind == "ascii":
        row = LEAST_BYTES["ascii"] * sum(counts)
    if not kind.startswith("binary") or kind == "binary":
        if points * row > size - rest + 1:  # the last line may lack its end
            raise ValueError(f"cut short: {points} points of at least {row} bytes in {size - rest} bytes")
        return
    with file.open("rb") as handle:
        handle.seek(rest)
        packed, unpacked = np.frombuffer(handle.read(8), "<u4").tolist()
    if unpacked != points * row or packed > size - rest - 8:
        raise ValueError(f"{unpacked} bytes in {packed} are not its {points} points of {row} bytes")


def _ply(file: Path, columns: list[str] | None) -> Columns:
    _check_ply(file)
    from plyfile import PlyData, PlyParseError

    try:
        vertices = PlyData.read(str(file))["vertex"].data
    except PlyParseError as error:
        raise ValueError(str(error)) from None
    return {name: np.array(vertices[name]) for name in vertices.dtype.names or ()}


def _check_ply(file: Path) -> None:
    """Refuse a header that says more than the file holds, or than a scan can have."""
    head, rest, size = _header(file, rb"^end_header[ \t]*\r?\n")
    lines = [words for line in head.splitlines() if (words := line.split())]
    if lines[0] != ["ply"]:
        raise ValueError("does not begin with ply")
    rows = properties = 0
    for words in lines:
        if words[0] == "property" and words[1] == "list":
            raise ValueError("a mesh: one of its properties is a list")
        if words[0] == "element":
            if not 0 <= int(words[2]) <= MOST_POINTS:
                raise ValueError(f"a header of {words[2]} points")
            rows, properties = int(words[2]), 0
        properties += words[0] == "property"
        if rows * properties > size - rest + 1 or properties > 1000:  # a number takes a byte at least
            raise ValueError(f"cut short: {rows} points of {properties} numbers in {size - rest} bytes")


def _header(file: Path, end: bytes) -> tuple[str, int, int]:
    """The header that the line `end` ends, where what follows begins, and the size of the file, in bytes."""
    with file.open("rb") as handle:
        begin = handle.read(HEADER)
    found = re.search(end, begin, re.MULTILINE)
    if found is None:
        raise ValueError("has no header")
    return begin[: found.end()].decode("ascii"), found.end(), file.stat().st_size


READERS: dict[str, Callable[[Path, list[str] | None], Columns]] = {
    ".bin": _bin,
    ".npy": _npy,
    ".pcd": _pcd,
    ".ply": _ply,
}
