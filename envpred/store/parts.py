"""Folders that are being written, each locked by its writer: what holds our mark and no lock, a killed one left."""

import contextlib
import glob
import os
import platform
import secrets
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from filelock import FileLock, Timeout

from envpred.interrupts import held

MARK = ".envpred"  # in a folder that is being written, locked by its writer
LOCK = ".lock"  # in a folder whose files are replaced together
SILENCE = 24 * 3600.0  # seconds that no writer is silent for
_PART, _WAIT = ".part-", 60.0  # seconds


@dataclass(frozen=True)
class Part:
    """A folder that this process alone writes, until it publishes or discards it, or ends."""

    folder: Path
    lock: FileLock

    def publish(self, target: Path) -> None:
        """Move it to `target`, which must not exist or be an empty folder."""
        with held():
            os.rename(self.folder, target)
            (target / MARK).unlink()  # not before: who looks for the mark meanwhile would make one, and lock that
            self.lock.release()

    def discard(self) -> None:
        """Remove it, if it is still there."""
        with held():
            with contextlib.suppress(OSError):
                _remove(self.folder)
            self.lock.release()


def begin(target: Path) -> Part:
    """A new folder beside `target`, to be filled and moved to its place.

    Raises:
        OSError: if there is no folder for it, which is not made: a worker that cannot see a store must not make one of
            its own; or if nothing can be written there.
    """
    part = None
    try:
        with held():  # until it can be discarded
            part = _begin(target)
    except BaseException:
        if part is not None:
            part.discard()
        raise
    return part


def _begin(target: Path) -> Part:
    """A new folder that is marked and locked."""
    while True:
        folder = target.with_name(f"{_PART}{target.name}-{platform.node()}-{secrets.token_hex(4)}")
        folder.mkdir()
        lock = FileLock(folder / MARK, timeout=_WAIT, thread_local=False)
        try:
            try:
                lock.acquire()
            except FileNotFoundError:  # taken for one whose writer was killed at this moment
                continue
            except (Timeout, NotImplementedError, OSError):  # a file system without locks: see `sweep`
                (folder / MARK).touch()
        except OSError:
            with contextlib.suppress(OSError):
                folder.rmdir()
            raise
        if (folder / MARK).is_file():
            return Part(folder, lock)


def sweep(folder: Path, name: str = "*") -> None:
    """Remove what killed writers of `name` (by default of all) left in `folder`: the parts that nobody has locked.

    Locks of some network disks do not reach other machines, so a part of another one must have been silent for a day,
    too; and any part where the file system has no locks.
    """
    names = name if name == "*" else glob.escape(name)
    for part in folder.glob(f"{_PART}{names}-*"):
        with contextlib.suppress(OSError):  # its writer may be done with it at this moment
            _remove_left(part)
    for mark in folder.glob(f"{names}/{MARK}"):
        if not mark.parent.name.startswith(_PART):  # published, and its writer killed before it could take the mark off
            with contextlib.suppress(OSError), FileLock(mark, timeout=0, thread_local=False):
                mark.unlink()


def sweep_below(folder: Path) -> None:
    """`sweep` every folder below `folder` in which a writer left something."""
    for place in {part.parent for part in folder.rglob(f"{_PART}*")}:
        sweep(place)


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Nobody else replaces files of `folder` together meanwhile, unless the file system has no locks."""
    lock = FileLock(folder / LOCK, timeout=_WAIT, thread_local=False)
    with contextlib.suppress(Timeout, NotImplementedError, OSError):
        lock.acquire()
    try:
        yield
    finally:
        lock.release()


def _remove_left(part: Path) -> None:
    if part.is_symlink():
        return
    with contextlib.suppress(OSError):
        part.rmdir()  # its writer was killed before it could mark it, or marks it now and makes another
        return
    if not (part / MARK).is_file():  # somebody else's
        return
    here = part.name.rpartition("-")[0].endswith(f"-{platform.node()}")
    lock = FileLock(part / MARK, timeout=0, thread_local=False)
    try:
        lock.acquire()
    except Timeout:
        return
    except (NotImplementedError, OSError):
        here = False
    try:
        if here or time.time() - max(file.stat().st_mtime for file in (part, *part.iterdir())) > SILENCE:
            _remove(part)
    finally:
        lock.release()


def _remove(part: Path) -> None:
    for file in part.iterdir():
        if file.name != MARK:
            shutil.rmtree(file) if file.is_dir() and not file.is_symlink() else file.unlink()
    (part / MARK).unlink()  # last: who is killed meanwhile leaves a part that is still known as ours
    part.rmdir()
