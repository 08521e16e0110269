"""Folders in which libraries keep what they make once: where neither package nor home can be written, they need others.

Numba keeps compiled loops beside their sources or in the home; matplotlib keeps its list of fonts in the home. Without,
each process makes them anew, the latter with a warning.
"""

import os
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent
COMPILED = ("mapping", "metrics", "simulate")  # rooms of the package that hold compiled loops


def give_folders() -> None:
    """Name a folder for each library that has none that can be written; processes that are started inherit it."""
    for name in _lacking():
        if (folder := _own()) is not None:
            os.environ[name] = str(folder / name.lower())


def _lacking() -> list[str]:
    """The variables of libraries that would find no folder."""
    return [
        name
        for name, places in _LIBRARIES.items()
        if name not in os.environ and not all(any(map(_writable, choice)) for choice in places())
    ]


def _numba() -> Iterator[list[Path]]:
    """Where numba looks for a place, for each room."""
    wide = _home("XDG_CACHE_HOME", ".cache") / "numba"
    for room in COMPILED:
        yield [PACKAGE / room / "__pycache__", wide]


def _matplotlib() -> Iterator[list[Path]]:
    yield [_home("XDG_CONFIG_HOME", ".config") / "matplotlib"]
    yield [_home("XDG_CACHE_HOME", ".cache") / "matplotlib"]


_LIBRARIES = {"NUMBA_CACHE_DIR": _numba, "MPLCONFIGDIR": _matplotlib}


def _home(variable: str, default: str) -> Path:
    """A folder in the home, as the XDG base directory specification names it; a relative one if there is no home."""
    return Path(os.environ.get(variable) or os.path.join(os.path.expanduser("~"), default))


def _writable(folder: Path) -> bool:
    """Whether files can be made in `folder`, or it can be made; what is relative would lie in any folder we run in."""
    if not folder.is_absolute():
        return False
    there = next(place for place in (folder, *folder.parents) if place.exists())
    return there.is_dir() and os.access(there, os.W_OK | os.X_OK)


def _own() -> Path | None:
    """A folder of this user among those for temporary files; None where there is none.

    Compiled code is loaded from it: one that others could have written to is left alone, and a new one made.
    """
    try:
        folder = Path(tempfile.gettempdir(), f"envpred-{os.getuid()}")
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
        if stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not stat.S_IMODE(found.st_mode) & 0o077:
            return folder
        return Path(tempfile.mkdtemp(prefix="envpred-"))
    except OSError:
        return None
