"""Writing a drive into a store so that it appears whole or not at all."""

import contextlib
import glob
import os
import platform
import time
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self

import numpy as np
from numpy.typing import DTypeLike, NDArray

from envpred import __version__
from envpred.errors import UserError
from envpred.store.files import FORMAT, MANIFEST, write_json
from envpred.store.groups import GROUPS
from envpred.store.parts import discard, make_part, unmark
from envpred.store.reading import StoredDrive

SILENCE = 24 * 3600.0  # seconds


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
        return {
            "file": self.file.name,
            "dtype": self.dtype.str,
            "shape": list(self.shape),
            "checksum": self.checksum,
        }

    def abandon(self) -> None:
        """Let go of the file without a word about its content, also when the disk takes no more of it."""
        if self._handle is not None:
            with contextlib.suppress(OSError):
                self._handle.close()


class DriveWriter:
    """Writes one drive, or one more group of arrays of a drive, so that it appears whole or not at all.

    Args:
        store: folder of the store, which must exist.
        drive: name of the drive.
        group: `mapping` for the drive itself; any other name completes a drive that is there.
        key: hash of the group's parameters, as `Store.claim` returns it.
        about: what the manifest says beside its arrays; of a drive that is completed, what changes.
        beside: further groups that are written in the same step, and the hashes of their parameters.

    Raises:
        UserError: on entering, if the drive's folder is there and holds no drive of a store.
    """

    def __init__(
        self,
        store: Path,
        drive: str,
        group: str,
        key: str,
        about: Mapping[str, Any],
        beside: Mapping[str, str] | None = None,
    ) -> None:
        self.folder, self.group, self.about = store / drive, group, about
        self.keys = {group: key, **(beside or {})}
        self.base = None if group == "mapping" else StoredDrive(self.folder).manifest["groups"]["mapping"]
        self.part = store / f".part-{drive}-{platform.node()}-{os.getpid()}"
        self.writers: dict[str, ArrayWriter] = {}
        self.groups: dict[str, str] = {}

    def add(self, name: str, dtype: DTypeLike, shape: tuple[int, ...], group: str | None = None) -> ArrayWriter:
        """A writer for the array `name`, of one of the groups `beside` if that is given."""
        self.writers[name] = ArrayWriter(self.part / f"{name}.npy", np.dtype(dtype), shape)
        self.groups[name] = group or self.group
        return self.writers[name]

    def __enter__(self) -> Self:
        sweep(self.part.parent, glob.escape(self.folder.name))
        self._check_place()
        make_part(self.part)
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
            discard(self.part)

    def _check_place(self) -> None:
        """Refuse to write over what is no drive of a store."""
        there = self.folder.is_symlink() or self.folder.exists()
        vacant = self.folder.is_dir() and not any(self.folder.iterdir())
        if there and not vacant and not (self.folder / MANIFEST).is_file():
            raise UserError(
                f"{self.folder}: has no {MANIFEST}, so it is no drive of this store, and holds other files; move it "
                "away, or give another --store"
            )

    def _publish(self) -> None:
        entries = {name: {**writer.close(), "group": self.groups[name]} for name, writer in self.writers.items()}
        if not (self.folder / MANIFEST).is_file():
            if self.base is not None:
                raise UserError(f"{self.folder}: was removed while {self.group} was built; run again")
            write_json(self.part / MANIFEST, self._manifest({}, entries))
            self._check_place()
            unmark(self.part)
            os.rename(self.part, self.folder)
            return
        old = StoredDrive(self.folder).manifest
        if self.base not in (None, old["groups"]["mapping"]):
            raise UserError(f"{self.folder}: was mapped anew while {self.group} was built; run again")
        # The old manifest stays true until it is replaced, so no file that it names may be touched before.
        valid = {entry["file"] for entry in old["arrays"].values()}
        for name, entry in entries.items():
            entry["file"] = next(file for file in (f"{name}.npy", f"{name}.1.npy") if file not in valid)
            os.replace(self.part / f"{name}.npy", self.folder / entry["file"])
        manifest = self._manifest({} if self.group == "mapping" else old, entries)
        write_json(self.folder / MANIFEST, manifest)
        # What no manifest names any more, or never did as its writer was killed; other files are not ours to remove.
        keep = {entry["file"] for entry in manifest["arrays"].values()}
        names = {*entries, *(array for group in GROUPS.values() for array in group.arrays)}
        for name in {f"{name}{again}.npy" for name in names for again in ("", ".1")} - keep:
            (self.folder / name).unlink(missing_ok=True)

    def _manifest(self, old: Mapping[str, Any], entries: Mapping[str, Any]) -> dict[str, Any]:
        """The manifest with the arrays of these groups in place of those that `old` has of them."""
        others = {name: entry for name, entry in old.get("arrays", {}).items() if entry["group"] not in self.keys}
        return {
            **(old or {"format": FORMAT}),
            **self.about,
            "groups": {**old.get("groups", {}), **self.keys},
            "arrays": {**others, **entries},
            "software": f"envpred {__version__}",
        }


def sweep(store: Path, drive: str = "*") -> None:
    """Remove parts of `drive` (by default of all) that killed builds left: those whose writer is no more."""
    for part in store.glob(f".part-{drive}-*"):
        node, _, pid = part.name.removeprefix(".part-").rpartition("-")
        with contextlib.suppress(FileNotFoundError):  # its writer may be done with it at this moment
            if node.endswith(f"-{platform.node()}") and pid.isdigit():
                gone = not _alive(int(pid))
            else:  # another machine's processes cannot be asked; no writer is silent for a day
                gone = time.time() - max(file.stat().st_mtime for file in (part, *part.iterdir())) > SILENCE
            if gone:
                discard(part)


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return pid != os.getpid()  # a part of our own number is left from an earlier life
