"""The index of a store, `store.json`: for each group of arrays the parameters that it is made with, and their hash."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from envpred.errors import UserError
from envpred.gate import read_json
from envpred.gate.stores import Index
from envpred.store.files import FORMAT, digest, flat, write_json
from envpred.store.parts import alone

INDEX = "store.json"


def read_index(folder: Path) -> dict[str, Any]:
    """The index of the store in `folder`.

    Raises:
        UserError: if there is none, or it is of another format.
    """
    file = folder / INDEX
    if not file.is_file():
        raise UserError(f"{folder}: no store of grids ({INDEX} is missing); build one with `envpred grids`")
    remedy = f"delete {folder} and run `envpred grids` again"
    index: dict[str, Any] = read_json(file, Index, remedy, FORMAT)
    for group, entry in index["groups"].items():
        if digest(entry["parameters"]) != entry["hash"]:
            raise UserError(f"{file}: the parameters of {group} have changed since it was built; {remedy}")
    return index


def claim(folder: Path, group: str, parameters: Mapping[str, Any], keeps: Callable[[], bool]) -> str:
    """Note that `group` is made with `parameters` in the store in `folder`, and return their hash.

    Args:
        folder: of the store; made if it is not there.
        group: name of the group.
        parameters: as plain data.
        keeps: tells whether the group stays as it is where it is made with other parameters.

    Raises:
        UserError: if it stays, the folder is no store, or it cannot be written.
    """
    key = digest(parameters)
    if (folder / INDEX).exists():
        if read_index(folder)["groups"].get(group, {}).get("hash") == key:
            return key
    elif folder.exists() and not _is_vacant(folder):
        raise UserError(f"{folder}: holds other files and is no store; give an empty or a new folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with alone(folder):
            _note(folder, group, parameters, key, keeps)
    except OSError as error:
        raise UserError(f"{folder}: cannot be written ({error.strerror}); make room or give another --store") from None
    return key


def differences(old: Mapping[str, Any], new: Mapping[str, Any], where: str) -> str:
    """What differs between two sets of parameters, as `ground.cell 0.4 there, 0.5 asked`, with `asked` as `where`."""
    there, here = flat(json.loads(json.dumps(old))), flat(json.loads(json.dumps(new)))
    return ", ".join(
        f"{name} {there.get(name)} there, {here.get(name)} {where}"
        for name in sorted({*there, *here})
        if there.get(name) != here.get(name)
    )


def _note(folder: Path, group: str, parameters: Mapping[str, Any], key: str, keeps: Callable[[], bool]) -> None:
    index: dict[str, Any] = {"format": FORMAT, "groups": {}}
    if (folder / INDEX).exists():
        index = read_index(folder)
    known, entry = index["groups"].get(group), {"hash": key, "parameters": parameters}
    if known is not None and known["hash"] != key:
        if keeps():
            raise UserError(
                f"{folder}: its {group} grids were built with other parameters "
                f"({differences(known['parameters'], parameters, 'asked')}); "
                "give another store, or --force to build them again"
            )
        before = {**known.get("before", {}), known["hash"]: known["parameters"]}
        entry["before"] = {hash_: values for hash_, values in before.items() if hash_ != key}  # drives may have them
    index["groups"][group] = entry
    write_json(folder / INDEX, index)


def _is_vacant(folder: Path) -> bool:
    """Whether nothing but hidden files is in the way: those an interrupted program leaves."""
    return folder.is_dir() and all(file.name.startswith(".") for file in folder.iterdir())
