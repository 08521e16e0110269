"""Results of test runs: one JSON each, with all that a report and paired statistics need."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from envpred import __version__
from envpred.horizons import PERIOD

if TYPE_CHECKING:
    from envpred.models.forecaster import Forecaster

FORMAT = 2
RESULT = "result.json"


def revision() -> str:
    """The git revision of a checkout (with `-dirty` if it was changed), else the version of the package."""
    command = [
        "git",
        "-C",
        str(Path(__file__).parent),
        "describe",
        "--always",
        "--dirty",
        "--exclude",
        "*",
        "--abbrev=40",
    ]
    try:
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return f"envpred {__version__}"


def write_test_result(
    forecaster: "Forecaster", folder: Path, metrics: Mapping[str, Any], seconds_per_window: float
) -> Path:
    """Write the result of a test run into its log `folder`; returns the file."""
    result = {
        "format": FORMAT,
        **provenance(forecaster, "test"),
        "metrics": metrics,
        "forecast_seconds_per_window": seconds_per_window,
    }
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / RESULT
    file.write_text(json.dumps(result, indent=1))
    return file


def provenance(forecaster: "Forecaster", part: str) -> dict[str, Any]:
    """How the forecasts of the windows of `part` were made: model, data, horizons, command, revision."""
    trainer, data = forecaster.trainer, forecaster.dataset
    return {
        "model": {
            "name": short_name(type(forecaster).__name__),
            "class_path": f"{type(forecaster).__module__}.{type(forecaster).__qualname__}",
            "parameters": sum(p.numel() for p in forecaster.parameters()),
            "flops": forecaster.flops(data.length, data.given),
            "hyperparameters": dict(forecaster.hparams),
        },
        "role": forecaster.role,
        "variant": data.variant,
        "data": data.describe(part),
        "seed": _seed(),
        "revision": revision(),
        "command": " ".join(["envpred", *sys.argv[1:]]),
        "checkpoint": str(trainer.ckpt_path) if trainer.ckpt_path else None,
        "horizon_s": [round(PERIOD * (h + 1), 3) for h in range(data.length - data.given)],
    }


def add_pictures(file: Path, pictures: Mapping[str, str], drawn: str) -> None:
    """Name pictures, and the file of the forecasts that are `drawn`, in the result `file`, by paths from its folder."""
    added = {"pictures": dict(pictures), "drawn": drawn}
    file.write_text(json.dumps(json.loads(file.read_text()) | added, indent=1))


def short_name(class_name: str) -> str:
    """Short name of a forecaster's class: PredNetForecaster -> prednet, LastFrame -> last_frame."""
    name = class_name.removesuffix("Forecaster")
    if class_name != name:
        return name.lower()
    return re.sub(r"(?<=.)([A-Z])", r"_\1", name).lower()


def _seed() -> int | None:
    seed = os.environ.get("PL_GLOBAL_SEED")
    return int(seed) if seed is not None else None
