"""What the command line makes of its surroundings: full disks, rights, a closed output, a folder that is gone."""

import errno
import os
import select
import shutil
import sys
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from io import TextIOWrapper
from pathlib import Path

from envpred.errors import UserError, printable

UNREAD = 141  # exit code, 128 and the number of SIGPIPE
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
LEAST = 64 * 1024  # bytes; a disk with fewer free takes nothing of ours


@contextmanager
def in_one_line(args: Sequence[str]) -> Iterator[None]:
    """Make one line of what the system refuses to a command with `args`, and end quietly where nobody reads its output.

    Raises:
        UserError: naming the file or the folder, and what to do.
    """
    if isinstance(sys.stdout, TextIOWrapper) and sys.stdout.errors == "strict":
        sys.stdout.reconfigure(errors="backslashreplace")  # what its encoding lacks is no reason to fail
    lost: list[OSError] = []
    try:
        with _threads_told(lost):
            try:
                yield
            except SystemExit:
                _flush()
                raise
        _flush()
        if lost:
            raise lost[0]
    except OSError as error:
        if _unread():
            sys.exit(UNREAD)
        if error.errno is None or (error.filename is None and error.errno not in FULL):
            raise
        raise UserError(_refused(error, args)) from None
    finally:
        try:
            _flush()
        except OSError:  # told above, and the interpreter would try once more
            with suppress(OSError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@contextmanager
def _threads_told(lost: list[OSError]) -> Iterator[None]:
    """Keep what the system refuses to threads, as TensorBoard's, which would each tell it by a traceback."""
    before = threading.excepthook

    def keep(told: threading.ExceptHookArgs) -> None:
        if isinstance(told.exc_value, OSError):
            lost.append(told.exc_value)
        else:
            before(told)

    threading.excepthook = keep
    try:
        yield
    finally:
        threading.excepthook = before


def current_folder() -> str:
    """The folder that the command is run in.

    Raises:
        UserError: if it is there no more.
    """
    try:
        return os.getcwd()
    except OSError as error:
        raise UserError(f"the current folder is gone ({error.strerror}); change into another one") from None


def in_utf8() -> None:
    """Start this program again in Python's UTF-8 mode where the locale spells names otherwise.

    Names of files are UTF-8 to what we read and write, and to libraries: TensorBoard finds no others.
    """
    if sys.getfilesystemencoding() != "utf-8" and os.environ.get("PYTHONUTF8") != "1":
        os.environ["PYTHONUTF8"] = "1"
        os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])


def check_spelt(args: Sequence[str]) -> None:
    """Refuse what is no UTF-8.

    Raises:
        UserError: naming the first.
    """
    for arg in args:
        try:
            arg.encode()
        except UnicodeEncodeError:
            told = arg.encode(errors="surrogateescape").decode(errors="replace")
            raise UserError(f"{printable(told)}: no name in UTF-8; rename it") from None


def is_full(folder: Path) -> bool:
    """Whether the disk of a folder takes nothing more of ours."""
    return shutil.disk_usage(folder).free < LEAST


def _refused(error: OSError, args: Sequence[str]) -> str:
    """One line for what the system refuses."""
    reason = error.strerror or str(error)
    if error.errno in FULL:
        place = error.filename or next(_full(args), "a disk, or a quota")
        return f"{place}: {reason}; make room, then run the same command again"
    if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        return f"{error.filename}: {reason}; mend its rights, or name another place"
    return f"{error.filename}: {reason}; look what is there, or name another place"


def _full(args: Sequence[str]) -> Iterator[str]:
    """What is full: the output, or a place that an argument names, or where files lie that none does."""
    try:
        print(flush=True)
    except OSError:
        yield "standard output"
    for value in (*(arg.rpartition("=")[2] for arg in args), ".", tempfile.gettempdir()):
        with suppress(OSError, ValueError):  # not every argument is a path
            place = Path(value).absolute()
            there = next(folder for folder in (place, *place.parents) if folder.is_dir())
            if is_full(there):
                yield str(there)


def _flush() -> None:
    if sys.stdout is not None:  # it is None where it was closed
        sys.stdout.flush()


def _unread() -> bool:
    """Whether the standard output is a pipe whose reader has gone."""
    with suppress(OSError, ValueError):
        look = select.poll()
        look.register(sys.stdout.fileno(), 0)
        return any(event & select.POLLERR for _, event in look.poll(0))
    return False
