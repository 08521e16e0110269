"""The plain files of a store beside its arrays: JSON replaced in one step, and hashes of plain data."""

import hashlib
import json
import os
from pathlib import Path
from typing import Any

from envpred.errors import UserError

FORMAT = 2
MANIFEST = "manifest.json"


def digest(value: Any) -> str:
    """A short hash of plain data that does not depend on the order of keys."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:16]


def write_json(file: Path, value: Any) -> None:
    """Replace `file` in one step."""
    part = file.with_name(f".{file.name}-{os.getpid()}")
    try:
        with part.open("w") as handle:
            json.dump(value, handle, indent=1)
            handle.flush()
            os.fsync(handle.fileno())
        os.replace(part, file)
    finally:
        part.unlink(missing_ok=True)


def read_json(file: Path) -> dict[str, Any]:
    try:
        value = json.loads(file.read_text())
    except FileNotFoundError:
        raise UserError(f"{file}: missing; run `envpred grids` to build it") from None
    except (OSError, ValueError):
        value = None
    if not isinstance(value, dict):
        raise UserError(f"{file}: cannot be read as JSON; delete its folder and run `envpred grids` again")
    return value
