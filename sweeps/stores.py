"""The grids that an ablation needs beside those it was given: the same drives, mapped in another way."""

import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from envpred.errors import UserError
from envpred.store import Store
from sweeps.plan import MAIN


@dataclass(frozen=True)
class Recipe:
    """What differs from the given store: arguments of `envpred grids` by name; None takes all of that name away."""

    changes: Mapping[str, Any]
    dogma: bool = False


RECIPES = {
    "ransac": Recipe({"ground": "RansacPlane"}),
    "ground_velocity": Recipe({"particles.filter.frame": "ground"}, dogma=True),
    "fewer_particles": Recipe({"particles.filter.persistent": 0.1, "particles.filter.births": 0.1}, dogma=True),
}


def command(key: str, main: Path, folder: Path, source: Path) -> list[str]:
    """The options of `envpred grids` that build the store `key` into `folder`, all else as in the store `main`."""
    recipe = RECIPES[key]
    options = _mapping(Store(main))
    if "ground" in recipe.changes:
        options = {name: value for name, value in options.items() if name.split(".", 1)[0] != "ground"}
    if recipe.dogma:
        options |= {"dogma": True, **_flat("particles", Store(main).parameters("dogma"))}
    for name, value in recipe.changes.items():
        # A share of what the given store has, or a value of its own.
        options[name] = max(1, round(options[name] * value)) if isinstance(value, float) else value
    drives = "[" + ",".join(Store(main).drives) + "]"
    given = {"source": source, "store": folder, "drives": drives, **options}
    return [f"--{name}={str(value).lower() if isinstance(value, bool) else value}" for name, value in given.items()]


def check(key: str, main: Path, source: Path | None, dynamic: bool) -> None:
    """Refuse what cannot be built before anything runs.

    Raises:
        UserError: if there is nothing to build it from.
    """
    if key != MAIN and source is None:
        raise UserError(
            f"the store of {key} is built from the drives; give their folder as --source, or other --switches"
        )
    lacking = [drive.name for drive in Store(main).drives.values() if not drive.has("velocity")]
    if (dynamic or (key in RECIPES and RECIPES[key].dogma)) and lacking:
        raise UserError(
            f"{main}: {', '.join(lacking)} hold no velocities; "
            f"build them with `envpred grids --source ... --store {main} --dogma true`"
        )


def is_whole(key: str, folder: Path, main: Path) -> bool:
    """Whether the store `key` in `folder` holds every drive of the store `main`, complete."""
    if not (folder / "store.json").is_file():
        return False
    drives = Store(folder).drives
    return all(
        name in drives and (drives[name].has("velocity") or not RECIPES[key].dogma) for name in Store(main).drives
    )


def build(key: str, main: Path, folder: Path, source: Path) -> None:
    """Build the store `key`, or what is missing of it.

    Raises:
        UserError: with the line of `envpred grids` if it fails.
    """
    done = subprocess.run(
        [sys.executable, "-m", "envpred.cli", "grids", *command(key, main, folder, source)],
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )
    if done.returncode:
        lines = [line for line in done.stderr.splitlines() if line.startswith("envpred: ")] or [done.stderr[-300:]]
        raise UserError(f"the store of {key} cannot be built: {lines[-1].removeprefix('envpred: ')}")


def _mapping(store: Store) -> dict[str, Any]:
    """The arguments of `envpred grids` by which the store was mapped."""
    parameters = dict(store.parameters("mapping"))
    ground = dict(parameters.pop("ground"))
    found: dict[str, Any] = {"ground": ground.pop("method"), **_flat("ground", ground)}
    for name, value in parameters.items():
        found |= _flat(name, value) if isinstance(value, Mapping) else {name: value}
    return found


def _flat(prefix: str, values: Mapping[str, Any]) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in values.items():
        flat |= _flat(f"{prefix}.{name}", value) if isinstance(value, Mapping) else {f"{prefix}.{name}": value}
    return flat
