"""Results of test runs, read and checked: what cannot be compared is refused, with the reason."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envpred.errors import UserError
from envpred.results.result import FORMAT, RESULT

FloatArray = NDArray[np.float64]

# What two results must agree in to be compared, as data -> what a user calls it.
SAME_DATA = {
    "store_hash": "grids",
    "split": "split",
    "given": "number of frames shown",
    "length": "window length",
    "window_rule": "window rule",
    "drives": "test drives",
    "windows": "test windows",
}
ROUNDING = 1e-4  # relative; the same numbers summed on another device


@dataclass(frozen=True)
class Measured:
    """A metric of a run: `mean` and `standard_error` (N,), `per_window` (W, N) or None; NaN where undefined."""

    mean: FloatArray
    standard_error: FloatArray
    per_window: FloatArray | None


@dataclass(frozen=True)
class Run:
    """One test run, as its result file tells it; `label` names it within a report."""

    file: Path
    label: str
    name: str
    variant: str
    horizon_s: FloatArray
    metrics: dict[str, Measured]
    reliability: dict[str, FloatArray] | None
    data: dict[str, Any]
    record: dict[str, Any]

    @property
    def mse(self) -> Measured:
        """The mean squared error, which every result has."""
        return self.metrics["mse"]


def read_runs(paths: Sequence[Path], same_inputs: bool = True) -> list[Run]:
    """The runs of result files, or of folders that hold some, checked to be of the same windows.

    With `same_inputs` False runs of one variant may have read other velocities, as where those are what is compared.

    Raises:
        UserError: naming the file and what is wrong with it: missing, damaged, of another format, partial, stale (other
            grids) or mixed (another split, other windows).
    """
    files = [file for path in paths for file in _result_files(Path(path))]
    runs = [read_run(file) for file in dict.fromkeys(file.resolve() for file in files)]
    if not runs:
        raise UserError("no test run given; name folders or files of results, as `envpred test` writes them")
    for run in runs[1:]:
        _check_comparable(runs[0], run, same_inputs)
    return _with_distinct_labels(runs)


def read_run(file: Path) -> Run:
    """The run of one result file.

    Raises:
        UserError: if it is damaged, of another format or partial.
    """
    try:
        record = json.loads(file.read_text())
    except (OSError, ValueError) as error:
        raise UserError(f"{file}: not a readable result ({error}); run `envpred test` again") from None
    if not isinstance(record, dict) or record.get("format") != FORMAT:
        found = record.get("format") if isinstance(record, dict) else None
        raise UserError(f"{file}: format {found}, this version reads {FORMAT}; run `envpred test` again")
    try:
        horizon_s = np.array(record["horizon_s"], np.float64)
        name, variant, data = str(record["model"]["name"]), str(record["variant"]), dict(record["data"])
        metrics = {
            key: _measured(file, key, value, len(horizon_s), len(data["windows"]))
            for key, value in record["metrics"].items()
            if "mean" in value
        }
        reliability = record["metrics"].get("reliability")
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise UserError(f"{file}: incomplete, {_what(error)}; run `envpred test` again") from None
    if "mse" not in metrics or metrics["mse"].per_window is None:
        raise UserError(f"{file}: incomplete, no mean squared error per window; run `envpred test` again")
    bins = {key: _array(value) for key, value in reliability.items()} if reliability else None
    label = f"{name} ({variant})"
    return Run(file, label, name, variant, horizon_s, metrics, bins, data, record)


def _result_files(path: Path) -> list[Path]:
    """The result files that `path` stands for."""
    if path.is_file():
        return [path]
    found = [path / RESULT] if (path / RESULT).is_file() else sorted(path.rglob(RESULT))
    if not found:
        raise UserError(f"{path}: no {RESULT} there; run `envpred test` first, or name the folder it logged to")
    return found


def _measured(file: Path, key: str, value: dict[str, Any], horizons: int, windows: int) -> Measured:
    """A metric of a result file, complete and consistent with itself."""
    mean, error = _array(value["mean"]), _array(value["standard_error"])
    if mean.shape != (horizons,) or error.shape != (horizons,):
        raise UserError(
            f"{file}: partial, {key} has {len(mean)} of the {horizons} horizons; run `envpred test` again to the end"
        )
    if "per_window" not in value:
        return Measured(mean, error, None)
    per_window = _array(value["per_window"])
    if per_window.shape != (windows, horizons):
        raise UserError(
            f"{file}: partial, {key} has {len(per_window)} of the {windows} windows at {horizons} horizons; "
            "run `envpred test` again to the end"
        )
    counted = np.isfinite(per_window)
    sums = np.where(counted, per_window, 0).sum(axis=0)
    again = np.divide(sums, counted.sum(axis=0), out=np.full(horizons, np.nan), where=counted.any(axis=0))
    if not np.allclose(again, mean, rtol=ROUNDING, equal_nan=True):
        raise UserError(f"{file}: damaged, the mean of {key} is not that of its windows; run `envpred test` again")
    return Measured(mean, error, per_window)


def _array(values: Any) -> FloatArray:
    """Numbers of a result file with NaN for null."""
    return np.array(values, dtype=object).astype(np.float64)


def _what(error: Exception) -> str:
    return f"{error} is missing" if isinstance(error, KeyError) else str(error)


def _check_comparable(first: Run, other: Run, same_inputs: bool) -> None:
    """Refuse two runs that were not measured on the same windows of the same grids."""
    for key, what in SAME_DATA.items():
        here, there = first.data.get(key), other.data.get(key)
        if here != there:
            stale = " (built again since, or another store)" if key == "store_hash" else ""
            shown = "" if key in ("windows", "store_hash") else f": {there} against {here}"
            raise UserError(
                f"{other.file}: other {what}{shown}{stale} than {first.file}; "
                "a report compares runs on the same windows: test both on the same data, or report them apart"
            )
    differ = first.data.get("input_hash") != other.data.get("input_hash")
    if same_inputs and first.variant == other.variant and differ:
        raise UserError(
            f"{other.file}: other velocities (built again since, or another store) than {first.file}, though both read "
            f"{first.variant}; run `envpred test` again for both"
        )
    if not np.array_equal(first.horizon_s, other.horizon_s):
        missing = sorted(set(first.horizon_s) ^ set(other.horizon_s))
        raise UserError(f"{other.file}: other horizons than {first.file}; {missing} s are in one of them only")
    if "static_mse" in first.metrics and "static_mse" in other.metrics:
        here, there = first.metrics["static_mse"].mean, other.metrics["static_mse"].mean
        if not np.allclose(here, there, rtol=ROUNDING):
            raise UserError(
                f"{other.file}: its static baseline differs from that of {first.file}, so they judge other grids; "
                "run `envpred test` again for both"
            )


def _with_distinct_labels(runs: list[Run]) -> list[Run]:
    """Runs of the same model and variant are told apart by seed, then by folder."""
    for describe in (lambda run: f"seed {run.record.get('seed')}", lambda run: run.file.parent.name):
        labels = [run.label for run in runs]
        runs = [
            replace(run, label=f"{run.label}, {describe(run)}") if labels.count(run.label) > 1 else run for run in runs
        ]
    labels = [run.label for run in runs]
    return [
        replace(run, label=f"{run.label}, {n + 1}") if labels.count(run.label) > 1 else run
        for n, run in enumerate(runs)
    ]
