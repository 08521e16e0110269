"""The grids that an ablation needs beside those it was given: the same drives, made in another way."""

import sys
import tempfile
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from envpred.build.dogma import build_dogma
from envpred.errors import UserError
from envpred.interrupts import heed
from envpred.mapping.dogma import DogmaParameters
from envpred.mapping.particle_state import GROUND, ParticleFilterParameters
from envpred.store import FORMAT, GROUPS, DriveWriter, Store, StoredDrive
from envpred.store.files import flat
from envpred.store.groups import command as making

from ..runs import processes
from .plan import MAIN
from .rollouts import ROLLOUT

Filter = ParticleFilterParameters


def _ground(given: Filter) -> Filter:
    """The filter for velocities relative to the ground, with as many particles and the period of another."""
    return replace(GROUND, persistent=given.persistent, births=given.births, period=given.period)


# Stores whose velocities are made by another filter, of the label grids that are there.
FILTERS: dict[str, Callable[[Filter], Filter]] = {
    "ground_velocity": _ground,
    "fewer_particles": lambda f: replace(f, persistent=max(1, f.persistent // 10), births=max(1, f.births // 10)),
}
# Stores that are mapped anew from the drives, with another ground segmentation.
GROUNDS = {"ransac": "RansacPlane"}
# What the store of the rollout has beside the grids of all, as `envpred grids --config rollout` makes it.
WIDER = 2  # times the judged grid: 256 cells
NEEDED = ("context_label", "context_evidence", "velocity", "velocity_cov")


def folder(key: str, main: Path, out: Path) -> Path:
    """Where the store `key` lies: below `out`, unless the store `main` does for it."""
    return main if key == MAIN or (key == ROLLOUT and _rolls(main)) else out / key


def _rolls(store: Path) -> bool:
    """Whether every drive of a store has what the rollout needs."""
    found = Store(store)
    ground = found.parameters("dogma").get("filter", {}).get("frame") == "ground"
    return ground and all(_holds(drive, NEEDED) for drive in found.drives.values())


def _holds(drive: StoredDrive, arrays: tuple[str, ...]) -> bool:
    return all(drive.has(array) for array in arrays)


def _lacks_context(main: Path) -> bool:
    return not all(_holds(drive, GROUPS["context"].arrays) for drive in Store(main).drives.values())


def check(key: str, main: Path, source: Path | None, dynamic: bool) -> None:
    """Refuse what cannot be built before anything runs.

    Raises:
        UserError: if there is nothing to build it from.
    """
    if source is None and (key in GROUNDS or (key == ROLLOUT and not _rolls(main) and _lacks_context(main))):
        raise UserError(
            f"the store of {key} is mapped from the drives; give their folder as --source, or other --switches"
        )
    lacking = [drive.name for drive in Store(main).drives.values() if not drive.has("velocity")]
    if (dynamic or key in FILTERS) and lacking:
        raise UserError(
            f"{main}: {', '.join(lacking)} hold no velocities; build them with `{making(main, 'velocity')}`"
        )


def is_whole(key: str, folder: Path, main: Path) -> bool:
    """Whether the store `key` in `folder` holds every drive of the store `main`, complete."""
    if key == MAIN:
        return True
    if not (folder / "store.json").is_file():
        return False
    needed = NEEDED if key == ROLLOUT else ("velocity",) if key in FILTERS else ()
    drives = Store(folder).drives
    return all(name in drives and _holds(drives[name], needed) for name in Store(main).drives)


def build(key: str, main: Path, folder: Path, source: Path | None) -> None:
    """Build the store `key`, or what is missing of it.

    Raises:
        UserError: if it fails, with the reason.
    """
    if key in GROUNDS:
        _map(key, folder, command(key, main, folder, source))
        return
    _copy_grids(Store(main), folder, "mapping")
    if key == ROLLOUT:
        if _lacks_context(main):
            _map(key, folder, command(key, main, folder, source))
        else:
            _copy_grids(Store(main), folder, "context")
    given = dict(Store(main).parameters("dogma")) or asdict(DogmaParameters())
    changed = FILTERS.get(key, _ground)(Filter(**given.pop("filter")))
    build_dogma(folder, DogmaParameters(changed, **given))


def command(key: str, main: Path, folder: Path, source: Path | None) -> list[str]:
    """The options of `envpred grids` that map the drives into the store `key`, all else as in the store `main`."""
    found = Store(main)
    parameters = dict(found.parameters("mapping"))
    ground = dict(parameters.pop("ground", {}))
    method = ground.pop("method", None)
    drives = "[" + ",".join(found.drives) + "]"
    given: dict[str, Any] = {"source": source, "store": folder, "drives": drives, **flat(parameters)}
    if key in GROUNDS:
        given["ground"] = GROUNDS[key]
    else:
        given |= {
            "ground": method,
            **flat(ground, "ground."),
            "context": WIDER * next(iter(found.drives.values())).grid.cells,
        }
    return [f"--{name}={value}" for name, value in given.items()]


def _map(key: str, folder: Path, options: list[str]) -> None:
    with tempfile.TemporaryFile() as log:
        process = processes.start([sys.executable, "-m", "envpred", "grids", *options], log)
        try:
            code = processes.wait(process)
        finally:
            processes.stop(process)
        log.seek(0)
        said = log.read().decode(errors="replace")
    if code:
        heed()  # of what has ended the mapping, too
        lines = [line for line in said.splitlines() if line.startswith("envpred: ")] or [said[-300:]]
        raise UserError(f"the store of {key} cannot be built: {lines[-1].removeprefix('envpred: ')}")


def _copy_grids(main: Store, folder: Path, group: str) -> None:
    """Copy a group of grids, to the bit: what is forecast stays the same."""
    target = Store(folder)
    key = target.claim(group, main.parameters(group))
    for name, drive in main.drives.items():
        if target.lacking(name, {group: key}):
            about = {k: v for k, v in drive.manifest.items() if k not in ("groups", "arrays", "software")}
            with DriveWriter(folder, name, group, key, about | {"format": FORMAT}) as out:
                for array in GROUPS[group].arrays:
                    values = drive.array(array)
                    writer = out.add(array, values.dtype, values.shape)
                    for frame in values:
                        writer.append(np.array(frame))
