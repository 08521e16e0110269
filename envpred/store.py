"""Grids on disk: a folder a drive, plain `.npy` files, and a manifest that is written last.

    store/store.json                 format, and for each group of arrays its parameters and their hash
    store/<drive>/manifest.json      frames, runs, lattice, group -> hash, array -> dtype, shape, checksum
    store/<drive>/<array>.npy

A group is what one step makes with one set of parameters: `mapping` the label grids and evidence, `dogma` the
velocities.  A drive appears by one rename and an array group by one replaced manifest, so whatever is interrupted
leaves a complete drive or none.
"""

import hashlib
import json
import os
import platform
import shutil
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self, cast

import numpy as np
from numpy.typing import DTypeLike, NDArray

from envpred import __version__
from envpred.errors import UserError

FORMAT = 1
MANIFEST = "manifest.json"


def digest(value: Any) -> str:
    """A short hash of plain data that does not depend on the order of keys."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:16]


class Store:
    """A folder of mapped drives."""

    def __init__(self, folder: Path | str) -> None:
        self.folder = Path(folder)

    @cached_property
    def drives(self) -> dict[str, "StoredDrive"]:
        """The finished drives by name, sorted.

        Raises:
            UserError: if the folder is no store, or of another format.
        """
        self._index()
        folders = sorted(f for f in self.folder.iterdir() if f.is_dir() and not f.name.startswith("."))
        return {f.name: StoredDrive(f) for f in folders if (f / MANIFEST).is_file()}

    def unfinished(self) -> list[str]:
        """Names of folders without a manifest: what an interrupted or foreign program left."""
        return sorted(
            f.name
            for f in self.folder.iterdir()
            if f.is_dir() and not f.name.startswith(".") and not (f / MANIFEST).is_file()
        )

    def parameters(self, group: str) -> dict[str, Any]:
        """The parameters that `group` was made with."""
        return cast(dict[str, Any], self._index()["groups"].get(group, {}).get("parameters", {}))

    def claim(self, group: str, parameters: Mapping[str, Any], *, force: bool = False) -> str:
        """Note that `group` is made with `parameters` in this store, and return their hash.

        Raises:
            UserError: if the store holds the group with other parameters and `force` is not set, or is no store.
        """
        key = digest(parameters)
        index: dict[str, Any] = {"format": FORMAT, "groups": {}}
        if (self.folder / "store.json").exists():
            index = self._index()
        elif self.folder.exists() and any(self.folder.iterdir()):
            raise UserError(f"{self.folder}: holds other files and is no store; give an empty or a new folder")
        known = index["groups"].get(group)
        if known is not None and known["hash"] != key:
            if not force:
                changed = sorted(
                    k for k in {*parameters, *known["parameters"]} if parameters.get(k) != known["parameters"].get(k)
                )
                raise UserError(
                    f"{self.folder}: its {group} grids were built with other parameters ({', '.join(changed)} differ); "
                    "give another store, or --force to build them again"
                )
            known = None
        if known is None:
            index["groups"][group] = {"hash": key, "parameters": parameters}
            self.folder.mkdir(parents=True, exist_ok=True)
            _write_json(self.folder / "store.json", index)
        return key

    def _index(self) -> dict[str, Any]:
        file = self.folder / "store.json"
        if not file.is_file():
            raise UserError(f"{self.folder}: no store of grids (store.json is missing); build one with `envpred grids`")
        index = _read_json(file)
        if index.get("format") != FORMAT:
            raise UserError(
                f"{file}: format {index.get('format')} is not {FORMAT}, which this version reads; build the store again"
            )
        return index


class StoredDrive:
    """A finished drive of a store, read by memory map."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.name = folder.name

    @cached_property
    def manifest(self) -> dict[str, Any]:
        return _read_json(self.folder / MANIFEST)

    @property
    def frames(self) -> list[int]:
        """Frame numbers of the drive that the arrays' first axis stands for."""
        return cast(list[int], self.manifest["frames"])

    @property
    def runs(self) -> list[tuple[int, int]]:
        """Stretches without a gap as (first, length), in positions along the arrays."""
        return [(first, length) for first, length in self.manifest["runs"]]

    @property
    def origin(self) -> NDArray[np.float64]:
        """World position (2,) of lattice cell (0, 0), in metres."""
        return np.array(self.manifest["lattice"]["origin"], np.float64)

    def has(self, name: str) -> bool:
        """Whether the drive holds the array `name`."""
        return name in self.manifest["arrays"]

    def array(self, name: str) -> NDArray[Any]:
        """The array `name`, mapped read-only; pages are given back when the last view of it goes.

        Raises:
            UserError: if the drive lacks it, or its file is damaged.
        """
        entry = self.manifest["arrays"].get(name)
        if entry is None:
            raise UserError(
                f"{self.folder}: holds no array {name!r}; build it with `envpred grids --store {self.folder.parent}"
                f"{'' if name in MAPPING_ARRAYS else ' --dogma true'}`"
            )
        file = self.folder / f"{name}.npy"
        try:
            array = np.load(file, mmap_mode="r", allow_pickle=False)
        except (OSError, ValueError, EOFError):
            raise UserError(f"{file}: missing or damaged; {self._remedy}") from None
        if list(array.shape) != entry["shape"] or array.dtype.str != np.dtype(entry["dtype"]).str:
            raise UserError(f"{file}: {array.dtype}{array.shape} is not what its manifest says; {self._remedy}")
        return cast(NDArray[Any], array)

    def verify(self) -> None:
        """Read every array and compare its checksum.

        Raises:
            UserError: naming the first file that does not fit the manifest.
        """
        for name, entry in self.manifest["arrays"].items():
            checksum = 0
            for frame in self.array(name):
                checksum = zlib.crc32(frame.tobytes(), checksum)
            if checksum != entry["checksum"]:
                raise UserError(f"{self.folder / name}.npy: its content has changed since it was built; {self._remedy}")

    @property
    def _remedy(self) -> str:
        return f"delete {self.folder} and run `envpred grids` again"


MAPPING_ARRAYS = ("label", "evidence", "centre_cell", "pose", "time")


@dataclass
class ArrayWriter:
    """An `.npy` file of known shape written frame by frame, so that memory does not grow with the drive."""

    file: Path
    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    checksum: int = 0
    written: int = 0
    _handle: BinaryIO | None = field(default=None, repr=False)

    def append(self, frame: NDArray[Any]) -> None:
        """Write the next frame, of shape `shape[1:]`."""
        if frame.shape != self.shape[1:]:
            raise ValueError(f"{self.file.name}: a frame of shape {frame.shape} where {self.shape[1:]} is expected")
        if self._handle is None:
            self._handle = self.file.open("wb")
            header = {"descr": self.dtype.str, "fortran_order": False, "shape": self.shape}
            np.lib.format.write_array_header_1_0(self._handle, header)
        data = frame.astype(self.dtype, copy=False).tobytes()
        self._handle.write(data)
        self.checksum = zlib.crc32(data, self.checksum)
        self.written += 1

    def extend(self, frames: NDArray[Any]) -> None:
        """Write several frames."""
        for frame in frames:
            self.append(np.asarray(frame))

    def close(self) -> dict[str, Any]:
        """Flush to the disk and return the array's entry of the manifest."""
        if self._handle is None or self.written != self.shape[0]:
            raise ValueError(f"{self.file.name}: {self.written} of {self.shape[0]} frames written")
        self._handle.flush()
        os.fsync(self._handle.fileno())
        self._handle.close()
        return {"dtype": self.dtype.str, "shape": list(self.shape), "checksum": self.checksum}

    def abandon(self) -> None:
        """Let go of the file without a word about its content."""
        if self._handle is not None:
            self._handle.close()


class DriveWriter:
    """Writes one drive, or one more group of arrays of a drive, so that it appears whole or not at all."""

    def __init__(self, store: Path, drive: str, group: str, key: str, about: Mapping[str, Any]) -> None:
        self.folder, self.group = store / drive, group
        self.completes = (self.folder / MANIFEST).is_file() and group != "mapping"
        self.part = store / f".part-{drive}-{platform.node()}-{os.getpid()}"
        self.manifest = _read_json(self.folder / MANIFEST) if self.completes else {"format": FORMAT, **about}
        self.manifest.setdefault("groups", {})[group] = key
        self.manifest.setdefault("arrays", {})
        self.writers: dict[str, ArrayWriter] = {}

    def add(self, name: str, dtype: DTypeLike, shape: tuple[int, ...]) -> ArrayWriter:
        """A writer for the array `name`."""
        self.writers[name] = ArrayWriter(self.part / f"{name}.npy", np.dtype(dtype), shape)
        return self.writers[name]

    def __enter__(self) -> Self:
        for stale in self.part.parent.glob(f".part-{self.folder.name}-{platform.node()}-*"):
            if not _alive(int(stale.name.rsplit("-", 1)[1])):
                shutil.rmtree(stale, ignore_errors=True)
        self.part.mkdir(parents=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self._publish()
        finally:
            for writer in self.writers.values():
                writer.abandon()
            shutil.rmtree(self.part, ignore_errors=True)

    def _publish(self) -> None:
        self.manifest["arrays"] |= {name: writer.close() for name, writer in self.writers.items()}
        self.manifest["software"] = f"envpred {__version__}"
        if self.completes:
            for name in self.writers:
                os.replace(self.part / f"{name}.npy", self.folder / f"{name}.npy")
            _write_json(self.folder / MANIFEST, self.manifest)
            return
        _write_json(self.part / MANIFEST, self.manifest)
        if self.folder.exists():  # unfinished, or built again on request: out of the way in one step
            old = self.part.with_name(self.part.name.replace(".part-", ".old-"))
            os.rename(self.folder, old)
            os.rename(self.part, self.folder)
            shutil.rmtree(old)
        else:
            os.rename(self.part, self.folder)


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return pid != os.getpid()  # a part of our own number is left from an earlier life


def _write_json(file: Path, value: Any) -> None:
    """Replace `file` in one step."""
    part = file.with_name(f".{file.name}-{os.getpid()}")
    with part.open("w") as handle:
        json.dump(value, handle, indent=1)
        handle.flush()
        os.fsync(handle.fileno())
    os.replace(part, file)


def _read_json(file: Path) -> dict[str, Any]:
    try:
        value = json.loads(file.read_text())
    except (OSError, ValueError):
        raise UserError(f"{file}: cannot be read as JSON; delete its folder and run `envpred grids` again") from None
    return cast(dict[str, Any], value)
