"""Writing a drive into a store so that it appears whole or not at all."""

import contextlib
import errno
import os
import shutil
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
from envpred.store.files import FORMAT, MANIFEST, checksum, replaced, write_json
from envpred.store.groups import GROUPS
from envpred.store.parts import Part, alone, begin, sweep
from envpred.store.reading import StoredDrive


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
        frame = frame.astype(self.dtype, copy=False)
        if frame.dtype.kind == "f" and not np.isfinite(frame).all():
            raise UserError(
                f"{self.file.stem}: frame {self.written} holds what is no finite number, so the drive is not kept; "
                "look at its scan and pose"
            )
        data = frame.tobytes()
        self._handle.write(data)
        self.checksum = zlib.crc32(data, self.checksum)
        self.written += 1

    def extend(self, frames: NDArray[Any]) -> None:
        """Write several frames."""
        for frame in frames:
            self.append(np.asarray(frame))

    def close(self) -> dict[str, Any]:
        """Flush to the disk and return the array's entry of the manifest.

        Raises:
            UserError: if the file is not the one that was written, whole.
        """
        if self._handle is None or self.written != self.shape[0]:
            raise ValueError(f"{self.file.name}: {self.written} of {self.shape[0]} frames written")
        self._handle.flush()
        os.fsync(self._handle.fileno())
        self._check(self._handle)
        self._handle.close()
        return {
            "file": self.file.name,
            "dtype": self.dtype.str,
            "shape": list(self.shape),
            "checksum": self.checksum,
        }

    def _check(self, handle: BinaryIO) -> None:
        """Read back what was written."""
        try:
            found = np.load(self.file, mmap_mode="r", allow_pickle=False)
            ours = os.path.samestat(os.fstat(handle.fileno()), self.file.stat())
            whole = (found.shape, found.dtype) == (self.shape, self.dtype)
            if ours and whole and checksum(self.file, found.offset) == self.checksum:
                return
        except (OSError, ValueError, EOFError):
            pass
        raise UserError(f"{self.file}: was removed or changed while it was written; run again")

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
        self.part: Part | None = None
        self.writers: dict[str, ArrayWriter] = {}
        self.groups: dict[str, str] = {}

    def add(self, name: str, dtype: DTypeLike, shape: tuple[int, ...], group: str | None = None) -> ArrayWriter:
        """A writer for the array `name`, of one of the groups `beside` if that is given."""
        assert self.part is not None, "enter first"
        self.writers[name] = ArrayWriter(self.part.folder / f"{name}.npy", np.dtype(dtype), shape)
        self.groups[name] = group or self.group
        return self.writers[name]

    def __enter__(self) -> Self:
        sweep(self.folder.parent, self.folder.name)
        self._check_place()
        self.part = begin(self.folder)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self.part is not None
        try:
            if kind is None:
                entries = {
                    name: {**writer.close(), "group": self.groups[name]} for name, writer in self.writers.items()
                }
                with alone(self.folder.parent):
                    self._publish(self.part, entries)
        finally:
            for writer in self.writers.values():
                writer.abandon()
            self.part.discard()

    def _check_place(self) -> None:
        """Refuse to write over what is no drive of a store."""
        there = self.folder.is_symlink() or self.folder.exists()
        vacant = self.folder.is_dir() and not any(self.folder.iterdir())
        if there and not vacant and not (self.folder / MANIFEST).is_file():
            raise UserError(
                f"{self.folder}: has no {MANIFEST}, so it is no drive of this store, and holds other files; move it "
                "away, or give another --store"
            )

    def _publish(self, part: Part, entries: dict[str, dict[str, Any]]) -> None:
        if not (self.folder / MANIFEST).is_file():
            if self.base is not None:
                raise UserError(f"{self.folder}: was removed while {self.group} was built; run again")
            write_json(part.folder / MANIFEST, self._manifest({}, entries))
            self._check_place()
            part.publish(self.folder)
            return
        old = StoredDrive(self.folder).manifest
        if self.base not in (None, old["groups"]["mapping"]):
            raise UserError(f"{self.folder}: was mapped anew while {self.group} was built; run again")
        # The old manifest stays true until it is replaced, so no file that it names may be touched before.
        valid = {entry["file"] for entry in old["arrays"].values()}
        for name, entry in entries.items():
            entry["file"] = next(file for file in (f"{name}.npy", f"{name}.1.npy") if file not in valid)
            _move(part.folder / f"{name}.npy", self.folder / entry["file"])
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


def _move(written: Path, target: Path) -> None:
    """Move an array to its place, also where a drive's folder is a link to another disk."""
    try:
        os.replace(written, target)
    except OSError as error:
        if error.errno != errno.EXDEV:
            raise
        with replaced(target) as part:
            shutil.copyfile(written, part)
