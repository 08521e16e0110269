"""The plain files of a store beside its arrays: text replaced in one step, and plain data hashed and flattened."""

import hashlib
import json
import os
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from envpred.errors import UserError
from envpred.store.parts import begin, sweep

FORMAT = 2
MANIFEST = "manifest.json"


def digest(value: Any) -> str:
    """A short hash of plain data that does not depend on the order of keys."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:16]


def flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested plain data as dotted name -> value; what is empty stays as it is."""
    found: dict[str, Any] = {}
    for name, value in values.items():
        deeper = isinstance(value, Mapping) and value
        found |= flat(value, f"{prefix}{name}.") if deeper else {f"{prefix}{name}": value}
    return found


def inside(folder: Path, name: object, source: Path) -> Path:
    """The file of the relative path `name` in `folder`, as the file `source` names it.

    Raises:
        UserError: if it lies elsewhere, by its name or as a link: such a file was not written here.
    """
    file, home = folder / str(name), folder.resolve()
    try:
        within = home in file.resolve().parents
    except (OSError, ValueError, RuntimeError):  # no name of a file, or a link that leads to itself
        within = False
    if not within:
        raise UserError(
            f"{source}: names {name!r}, which does not lie in {folder}; somebody has changed it: get it from where it "
            "was made, or make it again"
        )
    return file


def check_place(file: Path) -> None:
    """Refuse a file that could not be written, before there is work to lose; folders of it may still lack.

    Raises:
        UserError: naming what is in the way.
    """
    if file.is_dir():
        raise UserError(f"{file}: is a folder; name a file in it")
    there = next(place for place in file.absolute().parents if os.path.exists(place))
    if not (there.is_dir() and os.access(there, os.W_OK | os.X_OK)):
        reason = "is a folder that cannot be written" if there.is_dir() else "is no folder"
        raise UserError(f"{file}: cannot be written, as {there} {reason}; name another place")


def checksum(file: Path, start: int = 0, stop: int | None = None) -> int:
    """The CRC-32 of the bytes of `file` from `start` to `stop`; read, not mapped, whose pages would stay in memory."""
    found, left = 0, (file.stat().st_size if stop is None else stop) - start
    with file.open("rb") as handle:
        handle.seek(start)
        while left > 0 and (block := handle.read(min(left, 1 << 20))):
            found, left = zlib.crc32(block, found), left - len(block)
    return found


@contextmanager
def replaced(file: Path) -> Iterator[Path]:
    """A path near `file` to write to, of the same ending; it takes the place of `file` in one step.

    If the block fails, `file` stays what it was and nothing else is left, and what the system refuses names `file`.
    What a killed writer of `file` left, goes.
    """
    sweep(file.parent, file.name)
    part = begin(file)
    try:  # nothing comes between: a signal here would leave the part
        new = part.folder / f"new{file.suffix}"
        yield new
        with new.open("rb") as written:
            os.fsync(written.fileno())
        os.replace(new, file)
    except OSError as error:
        error.filename = str(file)
        raise
    finally:
        part.discard()


def replace_text(file: Path, text: str) -> Path:
    """Replace `file` in one step, also where several processes do so at once; returns it."""
    with replaced(file) as part:
        part.write_text(text, encoding="utf-8", errors="surrogateescape")  # names of files that the locale cannot spell
    return file


def write_json(file: Path, value: Any) -> None:
    """Replace `file` in one step."""
    replace_text(file, json.dumps(value, indent=1))
