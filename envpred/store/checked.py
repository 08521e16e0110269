"""Arrays that are trained or judged on are compared with their checksums once, until their files change."""

import contextlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from envpred.errors import UserError
from envpred.gate import read_json
from envpred.gate.stores import Checked
from envpred.store.files import write_json
from envpred.store.reading import StoredDrive

CHECKED = ".checked.json"  # in a store: "<drive>/<file>" -> size, time of change and checksum when it was compared


def check_content(store: Path, drives: Iterable[StoredDrive], arrays: Iterable[str]) -> None:
    """Compare those `arrays` of `drives` with their checksums whose files are new or have changed since last time.

    Raises:
        UserError: naming the first file that does not fit its manifest.
    """
    known, names = _known(store), list(arrays)
    fresh: dict[str, list[int]] = {}
    try:
        for drive in drives:
            for name in names:
                drive.array(name)  # refuses what is missing, or of another shape
                entry = drive.manifest["arrays"][name]
                place, file = f"{drive.name}/{entry['file']}", drive.folder / entry["file"]
                state = file.stat()
                told = [state.st_size, state.st_mtime_ns, entry["checksum"]]
                if known.get(place) != told and fresh.get(place) != told:
                    drive.verify_array(name)
                    fresh[place] = told
    finally:
        if fresh:
            with contextlib.suppress(OSError):  # a store that cannot be written is compared again next time
                write_json(store / CHECKED, {**_known(store), **fresh})


def _known(store: Path) -> dict[str, Any]:
    """What was compared before; nothing where that cannot be read."""
    try:
        known: dict[str, Any] = read_json(store / CHECKED, Checked, "delete it")
    except UserError:
        return {}
    return known
