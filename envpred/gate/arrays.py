"""Arrays (`.npy`, `.npz`): names, types, shapes and ranges are compared before anything is believed or loaded.

A header costs no memory whatever it says, archives are not unpacked beyond what their headers say, and nothing is ever
unpickled.
"""

import lzma
import math
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from envpred.errors import UserError, one_line, shown

LARGEST = 2**32  # bytes that an archive's arrays may have together
# What NumPy, torch, zipfile and their decompressors raise on what is no archive, or no longer.
DAMAGED = (
    *(OSError, ValueError, TypeError, LookupError, EOFError, ArithmeticError, MemoryError, RuntimeError, SyntaxError),
    AttributeError,
    *(zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error, tokenize.TokenError),
)

Header = tuple[tuple[int, ...], bool, np.dtype[Any]]  # shape, whether its first axis is the fastest, and type


@dataclass(frozen=True)
class ArraySchema:
    """What an array must be.

    Args:
        kinds: letters of `numpy.dtype.kind` that it may have: f for floating, i and u for whole numbers, U for text.
        shape: lengths of its axes, None for any; a name stands for a length that all arrays of a file share.
        low: least value.
        high: largest value.
        optional: whether it may be missing.
        finite: whether all of its numbers must be.
    """

    kinds: str
    shape: tuple[int | str, ...] | None
    low: float = -math.inf
    high: float = math.inf
    optional: bool = False
    finite: bool = True


Schemas = Mapping[str, ArraySchema]


def read_arrays(
    file: Path, schemas: Schemas | Callable[[Sequence[str]], Schemas], remedy: str
) -> dict[str, NDArray[Any]]:
    """The arrays of an archive (`.npz`) that `schemas` name, or a function that makes them of the names it holds.

    Raises:
        UserError: naming the file and what is wrong: missing, no archive, damaged, or not as the schemas say.
    """
    found: dict[str, NDArray[Any]] = {}
    lengths: dict[str, int] = {}
    with _told(file, remedy), zipfile.ZipFile(file) as archive:
        entries = {entry.filename.removesuffix(".npy"): entry for entry in archive.infolist()}
        if len(entries) < len(archive.infolist()):
            raise ValueError("holds a name twice")
        asked = schemas(list(entries)) if callable(schemas) else schemas
        needed = {name: schema for name, schema in asked.items() if name in entries or not schema.optional}
        missing = next((name for name in needed if name not in entries), None)
        if missing is not None:
            raise ValueError(f"holds no array {missing}")
        if sum(entries[name].file_size for name in needed) > LARGEST:
            raise ValueError(f"unpacks to more than {LARGEST >> 30} GiB")
        for name, schema in needed.items():
            with archive.open(entries[name]) as member:
                found[name] = _checked(name, member, entries[name].file_size, schema, lengths)
    return found


def read_array(file: Path, schema: ArraySchema, remedy: str) -> NDArray[Any]:
    """The array in `file` (`.npy`).

    Raises:
        UserError: naming the file and what is wrong: missing, no array, damaged, or not as the schema says.
    """
    with _told(file, remedy), file.open("rb") as handle:
        return _checked("the array", handle, file.stat().st_size, schema, {})


def map_array(file: Path, dtype: str, shape: Sequence[int], remedy: str) -> np.memmap[Any, Any]:
    """The array in `file` (`.npy`), mapped read-only.

    Args:
        file: of the array.
        dtype: that it must have, as `numpy.dtype.str`.
        shape: that it must have.
        remedy: what the user is to do if it is refused.

    Raises:
        UserError: naming the file and what is wrong: missing, no array, cut short, or of another type or shape.
    """
    with _told(file, remedy), file.open("rb") as handle:
        found, fortran, kind = _header(handle)
        if found != tuple(shape) or kind.str != dtype or fortran:
            raise ValueError(f"{kind}{found} is not what its manifest says")
        offset, size = handle.tell(), file.stat().st_size
        if size != offset + math.prod(found) * kind.itemsize:
            raise ValueError(f"has {size} bytes")
        return np.memmap(handle, kind, "r", offset, found)


@contextmanager
def _told(file: Path, remedy: str) -> Iterator[None]:
    try:
        yield
    except (FileNotFoundError, UnicodeEncodeError):
        raise UserError(f"{shown(file)}: missing; {remedy}") from None
    except DAMAGED as error:
        raise UserError(f"{file}: damaged, or not what belongs there ({one_line(error)}); {remedy}") from None


def _checked(name: str, handle: IO[bytes], size: int, schema: ArraySchema, lengths: dict[str, int]) -> NDArray[Any]:
    """The array that an open file of `size` bytes holds."""
    shape, fortran, dtype = _header(handle)
    if dtype.kind not in schema.kinds:
        raise ValueError(f"{name} has the type {dtype}")
    _check_shape(name, shape, schema, lengths)
    nbytes = math.prod(shape) * dtype.itemsize
    content = handle.read(nbytes + 1) if handle.tell() + nbytes == size else b""
    if len(content) != nbytes:
        raise ValueError(f"{name} is cut short, or too long")
    array = np.frombuffer(content, dtype).reshape(shape, order="F" if fortran else "C").copy()
    if dtype.kind in "fiu" and array.size and schema.finite:
        low, high = float(array.min()), float(array.max())
        if not (math.isfinite(low) and math.isfinite(high)):
            raise ValueError(f"{name} holds what is no number")
        if low < schema.low or high > schema.high:
            raise ValueError(f"{name} holds {low:.6g} to {high:.6g}, beyond {schema.low:.6g} to {schema.high:.6g}")
    return array


def _header(handle: IO[bytes]) -> Header:
    version = np.lib.format.read_magic(handle)
    read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}[version]
    shape, fortran, dtype = read(handle)
    if dtype.hasobject or dtype.names is not None or min(shape, default=0) < 0:
        raise ValueError(f"an array of {dtype}{shape}")
    return shape, fortran, dtype


def _check_shape(name: str, shape: tuple[int, ...], schema: ArraySchema, lengths: dict[str, int]) -> None:
    if schema.shape is None:
        return
    asked = [lengths.get(n) if isinstance(n, str) else n for n in schema.shape]
    if len(shape) != len(asked) or any(b is not None and a != b for a, b in zip(shape, asked, strict=True)):
        raise ValueError(f"{name} has the shape {shape}")
    lengths.update({n: length for n, length in zip(schema.shape, shape, strict=True) if isinstance(n, str)})
