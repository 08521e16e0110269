"""Finding drives: every reader is asked, those of this package and those that installed packages bring along.

A module of this package that defines `find(root) -> list[Drive]` is a reader.  Another package offers such a function
as an entry point:

    [project.entry-points."envpred.drives"]
    mine = "my_package.readers:find"
"""

import importlib
import inspect
import pkgutil
from collections.abc import Callable, Iterator
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType
from typing import cast

import envpred.drives
from envpred.drives.drive import Drive
from envpred.errors import UserError

GROUP = "envpred.drives"  # of the entry points
Find = Callable[[Path], list[Drive]]


def find_drives(root: Path | str, reader: str | None = None) -> list[Drive]:
    """All drives at or below `root` that a reader recognises, sorted by name.

    Args:
        root: folder with drives.
        reader: the only one that is asked, as module.function of a file of the user's own; by default all are.

    Raises:
        UserError: if `root` is not there or holds no drive, or a reader cannot be used.
    """
    root = Path(root)
    if not root.is_dir():
        raise UserError(f"{root}: no such folder; give the folder that holds your drives")
    found: dict[str, Drive] = {}
    for find in readers() if reader is None else [_own(reader)]:
        for drive in find(root):
            if drive.name in found:
                raise UserError(f"{root}: two drives are named {drive.name}; give the folder of one of them")
            found[drive.name] = drive
    if not found:
        raise UserError(
            f"{root}: no drive found; expected KITTI raw (<date>/<date>_drive_<number>_sync/velodyne_points/data), "
            "KITTI odometry (sequences/<number>/velodyne) or a folder with an envpred.yaml (docs/own_data.md)"
        )
    return [found[name] for name in sorted(found)]


def _own(name: str) -> Find:
    """The reader that a dotted name leads to."""
    module, _, function = name.rpartition(".")
    try:
        find = getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError, ValueError) as error:
        raise UserError(
            f"--reader {name}: {error}; give module.function of a file that Python finds from here"
        ) from None
    if not callable(find):
        raise UserError(f"--reader {name}: no function; give one that takes a folder and returns its drives")
    return cast(Find, find)


def one_drive(root: Path | str, name: str | None = None) -> Drive:
    """The drive of that name at or below `root`; without a name the first.

    Raises:
        UserError: if it is not there.
    """
    found = {drive.name: drive for drive in find_drives(root)}
    if name is not None and name not in found:
        raise UserError(f"{root}: no drive named {name}; it has {', '.join(found)}")
    return found[name or next(iter(found))]


def one_frame(drive: Drive, number: int | None = None) -> int:
    """The frame of that number of a drive; without a number the first.

    Raises:
        UserError: if the drive lacks it.
    """
    if number is not None and number not in drive.frames:
        raise UserError(f"{drive.name} has no frame {number}; it has {drive.frames[0]} to {drive.frames[-1]}")
    return drive.frames[0] if number is None else number


def readers() -> Iterator[Find]:
    """The functions that find drives.

    Raises:
        UserError: naming a reader that cannot be used.
    """
    for module in pkgutil.iter_modules(envpred.drives.__path__):
        reader = importlib.import_module(f"envpred.drives.{module.name}")
        find = getattr(reader, "find", None)
        if find is not None:
            yield find
        elif brings := drives_of(reader):
            raise UserError(
                f"{reader.__file__}: defines {brings[0]} but no function find(root) that finds such drives; add it"
            )
    for entry in entry_points(group=GROUP):
        try:
            found = entry.load()
        except (ImportError, AttributeError) as error:
            raise UserError(
                f"{entry.value}: the reader {entry.name} of an installed package cannot be loaded ({error}); "
                "mend or uninstall it"
            ) from None
        yield found


def drives_of(module: ModuleType) -> list[str]:
    """Names of the kinds of drives that `module` itself defines."""
    return [
        name
        for name, kind in inspect.getmembers(module, inspect.isclass)
        if issubclass(kind, Drive) and kind is not Drive and kind.__module__ == module.__name__
    ]
