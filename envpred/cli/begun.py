"""Folders of trainings: one process at a time writes one, and one that was ended before anything came of it goes."""

import contextlib
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from fnmatch import fnmatch
from pathlib import Path

from filelock import FileLock, Timeout

from envpred.cli.endings import CONFIG
from envpred.errors import UserError
from envpred.results.validations import VALIDATIONS, read_validations
from envpred.store.parts import LOCK, sweep

# What a training leaves in its folder before its first validation; whatever else lies there keeps the folder.
_EARLY = (LOCK, CONFIG, VALIDATIONS, "hparams.yaml", "events.out.tfevents.*", "checkpoints")
_CURVE = 600.0  # seconds of training whose curve somebody may want to see


@contextmanager
def own_folder(run: Path) -> Iterator[None]:
    """Nobody else trains into `run` meanwhile; where it is interrupted at its beginning, the folder goes.

    Raises:
        UserError: if another process trains into it.
    """
    lock = FileLock(run / LOCK, timeout=0, thread_local=False)
    while not lock.is_locked:
        run.mkdir(parents=True, exist_ok=True)
        try:
            lock.acquire()
        except FileNotFoundError:  # removed at this moment, as it was empty
            continue
        except Timeout:
            raise UserError(f"{run}: another process trains into it; wait for it, or train anew") from None
        except (NotImplementedError, OSError):  # a file system without locks
            break
    try:
        yield
    except (KeyboardInterrupt, SystemExit):
        _remove_early(run)
        raise
    finally:
        with contextlib.suppress(OSError):
            (run / LOCK).unlink()
        lock.release()


def clear(place: Path) -> None:
    """Remove those runs in `place` that were killed at their beginning."""
    for run in place.glob("*"):
        with contextlib.suppress(OSError):
            run.rmdir()  # killed before it could be locked
            continue
        if not (run / LOCK).is_file() or run.is_symlink():
            continue
        lock = FileLock(run / LOCK, timeout=0, thread_local=False)
        with contextlib.suppress(NotImplementedError, OSError, ValueError, UserError), lock:  # what is odd stays
            _remove_early(run)


def _remove_early(run: Path) -> None:
    """Remove a run that holds no more than a training writes at its beginning, if it can be removed."""
    for folder in (run, run / "checkpoints"):
        sweep(folder)  # of a checkpoint or a file that was being written
    files = [*run.iterdir(), *(run / "checkpoints").glob("*")]
    written = [file.stat().st_mtime for file in files]
    early = all(any(fnmatch(file.name, name) for name in _EARLY) for file in files)
    if early and not read_validations(run).validations and max(written) - min(written) < _CURVE:
        with contextlib.suppress(OSError):
            shutil.rmtree(run)
