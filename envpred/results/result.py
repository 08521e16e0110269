"""Results of test runs: one JSON each, with all that a report and paired statistics need."""

import re
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from envpred import __version__
from envpred.gate import read_json
from envpred.gate.runs import Result
from envpred.store.files import write_json

FORMAT = 4
RESULT = "result.json"
# Beside a new result the old one would still be found.
AGAIN = "delete it and run `envpred test` again"


def revision() -> str:
    """The git revision of a checkout (with `-dirty` if it was changed), else the version of the package."""
    folder = str(Path(__file__).parent)
    describe = ["describe", "--always", "--dirty", "--exclude", "*", "--abbrev=40"]
    try:
        return subprocess.run(
            ["git", "-C", folder, *describe], check=True, capture_output=True, encoding="utf-8"
        ).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return f"envpred {__version__}"


def write_result(file: Path, result: Mapping[str, Any]) -> Path:
    """Write the `result` of a test run into `file`, whole or not at all; returns the file."""
    file.parent.mkdir(parents=True, exist_ok=True)
    write_json(file, {"format": FORMAT, **result})
    return file


def read_result(file: Path) -> dict[str, Any]:
    """The result that a test run wrote.

    Raises:
        UserError: if it cannot be read, is of another format or incomplete.
    """
    result: dict[str, Any] = read_json(file, Result, AGAIN, FORMAT)
    return result


def name_pictures(file: Path, pictures: Mapping[str, str], drawn: str | None) -> None:
    """Name pictures, and the file of the forecasts that are `drawn`, in the result `file`, by paths from its folder."""
    write_json(file, read_result(file) | {"pictures": dict(pictures), "drawn": drawn})


def short_name(class_name: str) -> str:
    """Short name of a forecaster's class: PredNetForecaster -> prednet, LastFrame -> last_frame."""
    name = class_name.removesuffix("Forecaster").replace("PredNet", "Prednet")  # one word, whatever its capitals say
    return re.sub(r"(?<=[a-z0-9])([A-Z])", r"_\1", name).lower()
