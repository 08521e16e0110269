"""A checksum that a checkpoint carries as the comment of the archive that it is, so that a flipped bit is found."""

import io
import os
import zlib
from pathlib import Path
from typing import IO, Any, BinaryIO, cast

import torch

from envpred.store.files import checksum

_MARK, _END = b"envpred crc32 ", b"PK\x05\x06"  # before our checksum; and of the record that ends an archive
_COMMENT, _RECORD = len(_MARK) + 8, 22  # bytes
_fine: set[tuple[str, int, int, int]] = set()  # checkpoints that were read once: path, file, size, time of change


class _Summed:
    """What `torch.save` writes to, which adds up what is written."""

    def __init__(self, file: BinaryIO) -> None:
        self.file, self.sum = file, 0

    def write(self, data: bytes) -> int:
        self.sum = zlib.crc32(data, self.sum)
        return self.file.write(data)

    def flush(self) -> None:
        self.file.flush()


def save(checkpoint: dict[str, Any], file: Path) -> None:
    """Write a checkpoint with its checksum."""
    content = io.BytesIO()  # where torch writes to a disk that is full, it hides why it failed
    summed = _Summed(content)
    torch.save(checkpoint, cast(IO[bytes], summed))
    content.seek(-2, os.SEEK_END)  # the comment's length
    content.write(_COMMENT.to_bytes(2, "little") + _comment(summed.sum))
    file.write_bytes(content.getbuffer())


def check(file: Path) -> bool:
    """Whether a checkpoint carries a checksum, which is compared once until the file changes.

    Raises:
        OSError: if it cannot be read.
        ValueError: if it has changed since it was saved.
    """
    state = file.stat()
    known = (str(file.resolve()), state.st_ino, state.st_size, state.st_mtime_ns)
    if known in _fine:
        return True
    with file.open("rb") as handle:
        archive = handle.read(2) == b"PK"
        handle.seek(max(0, state.st_size - _COMMENT - 2))
        end = handle.read()
    if end[2:].startswith(_MARK):
        found = zlib.crc32(b"\0\0", checksum(file, stop=state.st_size - len(end)))
        if end != _COMMENT.to_bytes(2, "little") + _comment(found):
            raise ValueError(f"{file}: its content is not what was saved")
        _fine.add(known)
        return True
    if archive and not (end[-_RECORD:].startswith(_END) and end.endswith(b"\0\0")):  # cut, or what we would look for
        raise ValueError(f"{file}: is cut off")
    return False


def _comment(found: int) -> bytes:
    return _MARK + b"%08x" % found
