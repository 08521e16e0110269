"""Numba's `njit`, whose results are kept until the version or a source that they are made of changes.

Numba alone looks at the file of a loop, not at the constants and the inlined loops that the file imports.
"""

import contextlib
import functools
import hashlib
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import FunctionCache, IndexDataCacheFile

from envpred import __version__

PACKAGE = Path(__file__).parent
_IMPORT = re.compile(rf"^\s*(?:from|import) {PACKAGE.name}\.?(\S*)(?: import (\([^)]*\)|.*))?", re.MULTILINE)


def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function at its first call, and keep that for other processes where a folder can be written.

    Args:
        options: of `numba.njit`, but for `cache`.
    """

    def compiled(function: Callable[..., Any]) -> Any:
        loop = numba.njit(**options)(function)
        with contextlib.suppress(RuntimeError):  # no folder that can be written: each process compiles it
            loop._cache = _Cache(function)
        return loop

    return compiled


class _Cache(FunctionCache):
    """Numba's, which is emptied when the stamp of its sources changes."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call, unused-ignore]
        self._cache_file = IndexDataCacheFile(  # type: ignore[no-untyped-call, unused-ignore]
            cache_path=self._cache_path,
            filename_base=self._impl.filename_base,
            source_stamp=sources(Path(function.__code__.co_filename)),
        )


@functools.cache
def sources(file: Path) -> str:
    """A hash of the version, of `file`, and of all files of the package that it imports, be it by others."""
    found, waiting = {file}, [file]
    while waiting:
        fresh = _read(waiting.pop())[1] - found
        found |= fresh
        waiting += fresh
    return _hash("".join([__version__, *sorted(_read(file)[0] for file in found)]))


@functools.cache
def _read(file: Path) -> tuple[str, frozenset[Path]]:
    """The hash of a source, and the files of the package that it imports; not the package itself, which names all."""
    content = file.read_text(encoding="utf-8")
    imported = set()
    for module, names in _IMPORT.findall(content):
        place = PACKAGE.joinpath(*module.split("."))
        if (single := place.with_suffix(".py")).is_file():
            imported.add(single)
        else:
            inside = [place, *(place / name for name in re.findall(r"\w+", names))]
            imported |= {file for at in inside for file in (at.with_suffix(".py"), at / "__init__.py")}
    return _hash(content), frozenset(file for file in imported - {PACKAGE / "__init__.py"} if file.is_file())


def _hash(content: str) -> str:
    return hashlib.sha256(content.encode()).hexdigest()
