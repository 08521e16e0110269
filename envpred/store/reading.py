"""A store as its readers see it: the index with the parameters, and the finished drives."""

from collections.abc import Iterable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from envpred.errors import UserError
from envpred.gate import map_array, read_json
from envpred.gate.stores import Manifest
from envpred.mapping.geometry import Body, FloatArray, GridSpec
from envpred.store.files import FORMAT, MANIFEST, checksum, digest, inside
from envpred.store.groups import command, group_of
from envpred.store.index import claim, differences, read_index


class Store:
    """A folder of mapped drives."""

    def __init__(self, folder: Path | str) -> None:
        self.folder = Path(folder)

    @cached_property
    def drives(self) -> dict[str, "StoredDrive"]:
        """The finished drives by name, sorted.

        Raises:
            UserError: if the folder is no store, or of another format.
        """
        self._index()
        folders = sorted(f for f in self.folder.iterdir() if f.is_dir() and not f.name.startswith("."))
        return {f.name: StoredDrive(f) for f in folders if (f / MANIFEST).is_file()}

    def unfinished(self) -> list[str]:
        """Names of folders without a manifest: a drive whose manifest was removed, or what was never one."""
        return sorted(
            f.name
            for f in self.folder.iterdir()
            if f.is_dir() and not f.name.startswith(".") and not (f / MANIFEST).is_file()
        )

    def parameters(self, group: str) -> dict[str, Any]:
        """The parameters that `group` was made with."""
        return cast(dict[str, Any], self._index()["groups"].get(group, {}).get("parameters", {}))

    def lacking(self, drive: str, keys: Mapping[str, str]) -> dict[str, str]:
        """Those of the groups `keys` (name -> hash of parameters) that `drive` has not, or has with other parameters.

        Whoever lacks the mapping lacks them all, as they are made of it.
        """
        there = self.drives[drive].manifest["groups"] if drive in self.drives else {}
        missing = {group: key for group, key in keys.items() if there.get(group) != key}
        return dict(keys) if "mapping" in missing else missing

    def check(self, drives: Iterable[str], arrays: Iterable[str]) -> None:
        """Refuse what cannot be read together: an array that a drive lacks, or has from other parameters.

        Args:
            drives: names of drives of this store.
            arrays: names of stored arrays.

        Raises:
            UserError: with the command that mends it.
        """
        names = list(drives)
        for array in arrays:
            for name in names:
                self.drives[name].array(array)
            # What the others are made of must be of one kind too.
            for group in dict.fromkeys(("mapping", group_of(array) or "mapping")):
                key = digest(self.parameters(group))
                stale = [name for name in names if self.drives[name].manifest["groups"].get(group) != key]
                if stale:
                    raise UserError(
                        f"{self.folder}: the {group} grids of {', '.join(stale)} were built with other parameters than "
                        f"the store says{self._told(group, stale[0])}; run `{command(self.folder, array)}` again, with "
                        "the options they have now"
                    )

    def _told(self, group: str, stale: str) -> str:
        """What differs between the parameters of a drive and those of the store, where it is known."""
        known = self._index()["groups"].get(group, {})
        there = known.get("before", {}).get(self.drives[stale].manifest["groups"].get(group))
        return "" if there is None else f" ({differences(there, known['parameters'], 'in the store')})"

    def claim(self, group: str, parameters: Mapping[str, Any], *, force: bool = False) -> str:
        """Note that `group` is made with `parameters` in this store, and return their hash.

        Raises:
            UserError: if a drive has the group with other parameters and `force` is not set, or this is no store.
        """
        # Where no drive is finished, as after a first build that failed, nothing was built with other ones.
        return claim(self.folder, group, parameters, lambda: not force and self._has(group))

    def _has(self, group: str) -> bool:
        """Whether a drive has the group, as it is now."""
        return any(group in drive.manifest["groups"] for drive in Store(self.folder).drives.values())

    def _index(self) -> dict[str, Any]:
        return read_index(self.folder)


class StoredDrive:
    """A finished drive of a store, read by memory map."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.name = folder.name
        self._read_as: tuple[int, ...] | None = None

    @cached_property
    def manifest(self) -> dict[str, Any]:
        """What the drive holds.

        Raises:
            UserError: if it cannot be read, is of another format, or does not fit together.
        """
        file = self.folder / MANIFEST
        self._read_as = _identity(file)
        manifest: dict[str, Any] = read_json(file, Manifest, self._remedy, FORMAT)
        for entry in manifest["arrays"].values():
            inside(self.folder, entry["file"], file)
        return manifest

    @property
    def frames(self) -> list[int]:
        """Frame numbers of the drive that the arrays' first axis stands for."""
        return cast(list[int], self.manifest["frames"])

    @property
    def stretches(self) -> list[tuple[int, int]]:
        """Stretches without a gap as (first, length), in positions along the arrays."""
        return [(first, length) for first, length in self.manifest["stretches"]]

    @property
    def warnings(self) -> list[str]:
        """What was odd about its recording when it was mapped, a line each."""
        return cast(list[str], self.manifest.get("warnings", []))

    @property
    def origin(self) -> NDArray[np.float64]:
        """World position (2,) of lattice cell (0, 0), in metres."""
        return np.array(self.manifest["lattice"]["origin"], np.float64)

    @property
    def grid(self) -> GridSpec:
        """The grid that forecasts are judged on."""
        return GridSpec(self.manifest["lattice"]["cells"], self.manifest["lattice"]["resolution"])

    @property
    def context(self) -> GridSpec | None:
        """The wider grid around it, where the drive has one: the same lattice, the same centre cell."""
        lattice = self.manifest["lattice"]
        return GridSpec(lattice["context"], lattice["resolution"]) if self.has("context_label") else None

    @property
    def period(self) -> float:
        """Nominal time between frames, in seconds."""
        return float(self.manifest["period"])

    @property
    def body(self) -> Body:
        """The ego vehicle's body in the sensor frame."""
        return Body(**self.manifest["body"])

    @property
    def sensor_to_body(self) -> FloatArray:
        """Rigid transform (4, 4) from the sensor frame to the body frame."""
        return np.array(self.manifest["sensor"], np.float64)

    def has(self, name: str) -> bool:
        """Whether the drive holds the array `name`."""
        return name in self.manifest["arrays"]

    def array(self, name: str) -> np.memmap[Any, Any]:
        """The array `name`, mapped read-only; pages are given back when the last view of it goes.

        Raises:
            UserError: if the drive lacks it, its file is damaged, or it was built again since the manifest was read.
        """
        entry = self.manifest["arrays"].get(name)
        if entry is None:
            if group_of(name) is None:
                raise UserError(f"{self.folder}: holds no array {name!r}; it has {', '.join(self.manifest['arrays'])}")
            raise UserError(
                f"{self.folder}: holds no array {name!r}; build it with `{command(self.folder.parent, name)}`"
            )
        try:
            array = map_array(self.folder / entry["file"], entry["dtype"], entry["shape"], self._remedy)
        except UserError:
            self._check_still(name)
            raise
        self._check_still(name)  # after it was opened: what a manifest names stays while it is the valid one
        return array

    def _check_still(self, name: str) -> None:
        """Refuse an array that was built again since the manifest was read."""
        if _identity(self.folder / MANIFEST) == self._read_as:
            return
        now = StoredDrive(self.folder).manifest["arrays"].get(name)
        if now != self.manifest["arrays"][name]:
            raise UserError(f"{self.folder}: {name!r} was built again while it was read; run this command again")

    def verify(self) -> None:
        """Read every array and compare its checksum.

        Raises:
            UserError: naming the first file that does not fit the manifest.
        """
        for name in self.manifest["arrays"]:
            self.verify_array(name)

    def verify_array(self, name: str) -> None:
        """Read the array `name` and compare its checksum.

        Raises:
            UserError: if it does not fit the manifest.
        """
        entry = self.manifest["arrays"][name]
        file = self.folder / entry["file"]
        if checksum(file, self.array(name).offset) != entry["checksum"]:
            raise UserError(f"{file}: its content has changed since it was built; {self._remedy}")

    @property
    def _remedy(self) -> str:
        return f"delete {self.folder} and run `envpred grids` again"


def _identity(file: Path) -> tuple[int, ...] | None:
    """What tells a file from one that has taken its place; None if there is none."""
    try:
        found = file.stat()
    except OSError:
        return None
    return found.st_ino, found.st_mtime_ns, found.st_size
