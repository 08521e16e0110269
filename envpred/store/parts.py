"""Folders that are being written: marked as ours, so that nothing else is ever taken for what a killed program left."""

import contextlib
import shutil
from pathlib import Path

from envpred.store.files import MANIFEST

MARK = ".envpred"  # in a folder that is being written


def make_part(part: Path) -> None:
    """Make the folder `part`, which must not exist, and mark it.

    Raises:
        OSError: if it exists, or its parent does not: a worker that cannot see a store must not make one of its own.
    """
    part.mkdir()
    (part / MARK).write_text("being written by envpred; if nobody writes it any more, envpred removes it\n")


def unmark(part: Path) -> None:
    """Take the mark off a part that is complete, before it is moved to its place; its manifest says whose it is."""
    (part / MARK).unlink()


def discard(part: Path) -> None:
    """Remove a part that we wrote; what holds neither our mark nor a manifest is somebody else's, and stays."""
    with contextlib.suppress(OSError):
        part.rmdir()  # made, and its writer killed before it could mark it
        return
    kept = [file for file in (part / MARK, part / MANIFEST) if file.is_file()]
    if not kept or part.is_symlink():
        return
    with contextlib.suppress(OSError):
        for file in part.iterdir():
            if file not in kept:
                shutil.rmtree(file) if file.is_dir() and not file.is_symlink() else file.unlink()
        for file in kept:  # last: who is killed meanwhile leaves a part that is still known as ours
            file.unlink()
        part.rmdir()
