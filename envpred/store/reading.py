"""A store as its readers see it: the index with the parameters, and the finished drives."""

import json
from collections.abc import Iterable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from envpred.errors import UserError
from envpred.mapping.geometry import Body, FloatArray, GridSpec
from envpred.store.files import FORMAT, MANIFEST, checksum, digest, flat, inside, read_json, write_json
from envpred.store.groups import command, group_of
from envpred.store.parts import alone


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
                        f"the store says; run `{command(self.folder, array)}` again, with the options they have now"
                    )

    def claim(self, group: str, parameters: Mapping[str, Any], *, force: bool = False) -> str:
        """Note that `group` is made with `parameters` in this store, and return their hash.

        Raises:
            UserError: if a drive has the group with other parameters and `force` is not set, or this is no store.
        """
        key = digest(parameters)
        if self._claimed(group, key):
            return key
        if not (self.folder / "store.json").exists() and self.folder.exists() and not _is_vacant(self.folder):
            raise UserError(f"{self.folder}: holds other files and is no store; give an empty or a new folder")
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with alone(self.folder):
                self._claim(group, parameters, key, force)
        except OSError as error:
            raise UserError(
                f"{self.folder}: cannot be written ({error.strerror}); make room or give another --store"
            ) from None
        return key

    def _claimed(self, group: str, key: str) -> bool:
        """Whether `group` is noted to be made with the parameters of that hash."""
        return (self.folder / "store.json").exists() and self._index()["groups"].get(group, {}).get("hash") == key

    def _claim(self, group: str, parameters: Mapping[str, Any], key: str, force: bool) -> None:
        index: dict[str, Any] = {"format": FORMAT, "groups": {}}
        if (self.folder / "store.json").exists():
            index = self._index()
        known = index["groups"].get(group)
        if known is not None and known["hash"] != key:
            # Where no drive is finished, as after a first build that failed, nothing was built with those.
            built = any(group in drive.manifest["groups"] for drive in Store(self.folder).drives.values())
            if built and not force:
                raise UserError(
                    f"{self.folder}: its {group} grids were built with other parameters "
                    f"({_differences(known['parameters'], parameters)}); "
                    "give another store, or --force to build them again"
                )
        index["groups"][group] = {"hash": key, "parameters": parameters}
        write_json(self.folder / "store.json", index)

    def _index(self) -> dict[str, Any]:
        file = self.folder / "store.json"
        if not file.is_file():
            raise UserError(f"{self.folder}: no store of grids (store.json is missing); build one with `envpred grids`")
        index = read_json(file)
        if index.get("format") != FORMAT:
            raise UserError(
                f"{file}: format {index.get('format')} is not {FORMAT}, which this version reads; build the store again"
            )
        return index


class StoredDrive:
    """A finished drive of a store, read by memory map."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.name = folder.name

    @cached_property
    def manifest(self) -> dict[str, Any]:
        """What the drive holds.

        Raises:
            UserError: if it cannot be read, or is of another format.
        """
        file = self.folder / MANIFEST
        manifest = read_json(file)
        if manifest.get("format") != FORMAT:
            raise UserError(
                f"{file}: format {manifest.get('format')} is not {FORMAT}, which this version reads; {self._remedy}"
            )
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
            UserError: if the drive lacks it, or its file is damaged.
        """
        entry = self.manifest["arrays"].get(name)
        if entry is None:
            if group_of(name) is None:
                raise UserError(f"{self.folder}: holds no array {name!r}; it has {', '.join(self.manifest['arrays'])}")
            raise UserError(
                f"{self.folder}: holds no array {name!r}; build it with `{command(self.folder.parent, name)}`"
            )
        file = self.folder / entry["file"]
        try:
            array = np.load(file, mmap_mode="r", allow_pickle=False)
        except (OSError, ValueError, EOFError):
            raise UserError(f"{file}: missing or damaged; {self._remedy}") from None
        if list(array.shape) != entry["shape"] or array.dtype.str != np.dtype(entry["dtype"]).str:
            raise UserError(f"{file}: {array.dtype}{array.shape} is not what its manifest says; {self._remedy}")
        return cast(np.memmap[Any, Any], array)

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


def _is_vacant(folder: Path) -> bool:
    """Whether nothing but hidden files is in the way: those an interrupted program leaves."""
    return folder.is_dir() and all(file.name.startswith(".") for file in folder.iterdir())


def _differences(old: Mapping[str, Any], new: Mapping[str, Any]) -> str:
    """What differs between two sets of parameters, as `ground.cell 0.4 there, 0.5 asked`."""
    there, asked = flat(json.loads(json.dumps(old))), flat(json.loads(json.dumps(new)))
    return ", ".join(
        f"{name} {there.get(name)} there, {asked.get(name)} asked"
        for name in sorted({*there, *asked})
        if there.get(name) != asked.get(name)
    )
