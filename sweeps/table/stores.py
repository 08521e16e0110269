"""The grids that an ablation needs beside those it was given: the same drives, made in another way."""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from envpred.build.dogma import build_dogma
from envpred.errors import UserError
from envpred.mapping.dogma import DogmaParameters
from envpred.mapping.particle_state import GROUND, ParticleFilterParameters
from envpred.store import FORMAT, MAPPING_ARRAYS, DriveWriter, Store
from envpred.store.files import flat
from sweeps.table.plan import MAIN

Filter = ParticleFilterParameters

# Stores whose velocities are made by another filter, of the label grids that are there.
FILTERS: dict[str, Callable[[Filter], Filter]] = {
    "ground_velocity": lambda f: replace(GROUND, persistent=f.persistent, births=f.births, period=f.period),
    "fewer_particles": lambda f: replace(f, persistent=max(1, f.persistent // 10), births=max(1, f.births // 10)),
}
# Stores that are mapped anew from the drives, with another ground segmentation.
GROUNDS = {"ransac": "RansacPlane"}


def check(key: str, main: Path, source: Path | None, dynamic: bool) -> None:
    """Refuse what cannot be built before anything runs.

    Raises:
        UserError: if there is nothing to build it from.
    """
    if key in GROUNDS and source is None:
        raise UserError(
            f"the store of {key} is mapped from the drives; give their folder as --source, or other --switches"
        )
    lacking = [drive.name for drive in Store(main).drives.values() if not drive.has("velocity")]
    if (dynamic or key in FILTERS) and lacking:
        raise UserError(
            f"{main}: {', '.join(lacking)} hold no velocities; "
            f"build them with `envpred grids --source ... --store {main} --dogma true`"
        )


def is_whole(key: str, folder: Path, main: Path) -> bool:
    """Whether the store `key` in `folder` holds every drive of the store `main`, complete."""
    if key == MAIN:
        return True
    if not (folder / "store.json").is_file():
        return False
    drives = Store(folder).drives
    return all(name in drives and (drives[name].has("velocity") or key not in FILTERS) for name in Store(main).drives)


def build(key: str, main: Path, folder: Path, source: Path | None) -> None:
    """Build the store `key`, or what is missing of it.

    Raises:
        UserError: if it fails, with the reason.
    """
    if key in GROUNDS:
        _map(key, main, folder, source)
    else:
        _copy_grids(Store(main), folder)
        given = dict(Store(main).parameters("dogma"))
        changed = FILTERS[key](Filter(**given.pop("filter")))
        build_dogma(folder, DogmaParameters(changed, **given))


def command(key: str, main: Path, folder: Path, source: Path) -> list[str]:
    """The options of `envpred grids` that map the drives into the store `key`, all else as in the store `main`."""
    parameters = dict(Store(main).parameters("mapping")) | {"ground": GROUNDS[key]}
    drives = "[" + ",".join(Store(main).drives) + "]"
    given = {"source": source, "store": folder, "drives": drives, **flat(parameters)}
    return [f"--{name}={value}" for name, value in given.items()]


def _map(key: str, main: Path, folder: Path, source: Path | None) -> None:
    assert source is not None  # `check` has seen to that
    options = command(key, main, folder, source)
    done = subprocess.run(
        [sys.executable, "-m", "envpred", "grids", *options], stderr=subprocess.PIPE, text=True, check=False
    )
    if done.returncode:
        lines = [line for line in done.stderr.splitlines() if line.startswith("envpred: ")] or [done.stderr[-300:]]
        raise UserError(f"the store of {key} cannot be built: {lines[-1].removeprefix('envpred: ')}")


def _copy_grids(main: Store, folder: Path) -> None:
    """Copy label grids and evidence, to the bit: what is forecast stays the same."""
    target = Store(folder)
    key = target.claim("mapping", main.parameters("mapping"))
    for name, drive in main.drives.items():
        if name not in target.drives:
            about = {k: v for k, v in drive.manifest.items() if k not in ("groups", "arrays", "software")}
            with DriveWriter(folder, name, "mapping", key, about | {"format": FORMAT}) as out:
                for array in MAPPING_ARRAYS:
                    values = drive.array(array)
                    writer = out.add(array, values.dtype, values.shape)
                    for frame in values:
                        writer.append(np.array(frame))
