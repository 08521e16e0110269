"""Results of test runs, read and checked: what cannot be compared is refused, with the reason."""

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from envpred.errors import UserError
from envpred.gate import conform
from envpred.gate.runs import Diagram, Metric
from envpred.metrics.about import About
from envpred.report.comparable import ROUNDING, check_comparable
from envpred.report.run import FloatArray, Measured, Run
from envpred.report.statistics import drive_errors
from envpred.results.names import input_name, method_name
from envpred.results.result import AGAIN, RESULT, read_result

Found = TypeVar("Found")
NAMED = 4  # folders that a line names before it counts the others
FEW = 2  # hyperparameters that a label tells


def read_runs(paths: Sequence[Path], same_inputs: bool = True) -> list[Run]:
    """The runs of result files, or of folders that hold some, checked to be of the same windows.

    Folders that hold none, as those of training, are left out, with a line on standard error.

    With `same_inputs` False an array beside what is judged (a velocity, say) may differ between runs, as where that is
    what is compared.

    Raises:
        UserError: if no folder holds one, or naming the file and what is wrong with it: missing, damaged, of another
            format, partial, stale (other grids) or mixed (another split, other windows).
    """
    runs = [read_run(file) for file in result_files(paths)]
    check_comparable(runs, same_inputs)
    return with_distinct_labels(runs)


def result_files(paths: Sequence[Path]) -> list[Path]:
    """The result files that paths name, or that folders hold, each once.

    Folders that hold none, as those of training, are left out, with a line on standard error.

    Raises:
        UserError: if no folder holds one.
    """
    if not paths:
        raise UserError("no test run given; name folders or files of results, as `envpred test` writes them")
    remedy = "run `envpred test` first, or name the folder it logged to"
    files = [file for files in found_in(paths, _result_files, RESULT, remedy) for file in files]
    return list(dict.fromkeys(file.resolve() for file in files))


def read_run(file: Path) -> Run:
    """The run of one result file.

    Raises:
        UserError: if it is damaged, of another format or partial.
    """
    record = read_result(file)
    horizon_s, data = np.array(record["horizon_s"], np.float64), record["data"]
    drives = [drive for drive, _ in data["windows"]]
    metrics = {
        key: _measured(file, key, value, len(horizon_s), drives)
        for key, value in record["metrics"].items()
        if "mean" in value
    }
    if "mse" not in metrics or metrics["mse"].per_window is None:
        raise UserError(f"{file}: incomplete, no mean squared error per window; {AGAIN}")
    name, role, variant = record["model"]["name"], record["role"], record["variant"]
    method = method_name(record["model"], role, variant)
    bins = _diagram(file, record["metrics"].get("reliability"), len(horizon_s))
    return Run(file, method, method, name, role, variant, horizon_s, metrics, bins, data, record)


def found_in(folders: Sequence[Path], look: Callable[[Path], Found | None], what: str, remedy: str) -> list[Found]:
    """What `look` finds in folders, or nothing; those without are left out, with a line on standard error.

    Raises:
        UserError: if there is no such folder, or none of them holds any, with what to do then.
    """
    paths = [Path(folder) for folder in folders]
    missing = next((path for path in paths if not path.exists()), None)
    if missing is not None:
        raise UserError(f"{missing}: no such file or folder")
    looked = [(path, look(path)) for path in paths]
    without = [str(path) for path, held in looked if not held]
    more = f" and {len(without) - NAMED} more" if len(without) > NAMED else ""
    names = ", ".join(without[:NAMED]) + more
    if len(without) == len(paths):
        raise UserError(f"{names}: no {what} there; {remedy}")
    if without:
        print(f"skipped {len(without)} folder{'s' * (len(without) > 1)} without {what}: {names}", file=sys.stderr)
    return [held for _, held in looked if held]


def _result_files(path: Path) -> list[Path]:
    """The result files that `path` stands for."""
    if path.is_file():
        return [path]
    return [path / RESULT] if (path / RESULT).is_file() else sorted(path.rglob(RESULT))


def _measured(file: Path, key: str, value: dict[str, Any], horizons: int, drives: Sequence[str]) -> Measured:
    """A metric of a result file, complete and consistent with itself."""
    conform(value, Metric, f"{file}: {key}", AGAIN)
    mean, error = _array(value["mean"]), _array(value["standard_error"])
    if mean.shape != (horizons,) or error.shape != (horizons,):
        raise UserError(f"{file}: partial, {key} has {len(mean)} of the {horizons} horizons; {AGAIN}, to the end")
    about = About.of(value)
    if "per_window" not in value:
        return Measured(mean, error, None, about)
    per_window, windows = _array(value["per_window"]), len(drives)
    if per_window.shape != (windows, horizons):
        raise UserError(
            f"{file}: partial, {key} has {len(per_window)} of the {windows} windows at {horizons} horizons; "
            f"{AGAIN}, to the end"
        )
    counted = np.isfinite(per_window)
    sums = np.where(counted, per_window, 0).sum(axis=0)
    again = np.divide(sums, counted.sum(axis=0), out=np.full(horizons, np.nan), where=counted.any(axis=0))
    if not np.allclose(again, mean, rtol=ROUNDING, equal_nan=True):
        raise UserError(f"{file}: damaged, the mean of {key} is not that of its windows; {AGAIN}")
    return Measured(mean, error, per_window, about, drive_errors(per_window, drives))


def _array(values: Any) -> FloatArray:
    """Numbers of a result file with NaN for null."""
    return np.array(values, dtype=object).astype(np.float64)


def _diagram(file: Path, value: dict[str, Any] | None, horizons: int) -> dict[str, FloatArray] | None:
    """The reliability diagram of a result file, if it has one."""
    if not value:
        return None
    found = conform(value, Diagram, f"{file}: reliability", AGAIN)
    if len(found.count) != horizons:
        raise UserError(f"{file}: partial, reliability has {len(found.count)} of the {horizons} horizons; {AGAIN}")
    return {key: _array(getattr(found, key)) for key in ("forecast", "occupied", "count")}


def with_distinct_labels(runs: Sequence[Run]) -> list[Run]:
    """Runs labelled by their methods; those of one method by what differs, else by seed, by folder, then by number."""
    labelled = [replace(run, label=run.method) for run in runs]
    for describe in (_differing, _seeds, _folders):
        for label in dict.fromkeys(run.label for run in labelled):
            alike = [n for n, run in enumerate(labelled) if run.label == label]
            if len(alike) > 1:
                for n, words in zip(alike, describe([labelled[n] for n in alike]), strict=True):
                    labelled[n] = replace(labelled[n], label=f"{label}, {words}" if words else label)
    labels = [run.label for run in labelled]
    return [
        replace(run, label=f"{run.label}, {n + 1}") if labels.count(run.label) > 1 else run
        for n, run in enumerate(labelled)
    ]


def _differing(runs: Sequence[Run]) -> list[str]:
    """The input and the few hyperparameters in which runs of one method differ, if it is few."""
    inputs = [input_name(run.variant) for run in runs]
    told = [run.record["model"]["hyperparameters"] for run in runs]
    keys = {key for values in told for key in values.keys() - {"variant", "seed"}}
    differing = sorted(key for key in keys if any(values.get(key) != told[0].get(key) for values in told))
    found = [[] if len(set(inputs)) == 1 else [name] for name in inputs]
    if len(differing) <= FEW:
        for words, values in zip(found, told, strict=True):
            words += [f"{key.replace('_', ' ')} {values.get(key)}" for key in differing]
    return [", ".join(words) for words in found]


def _seeds(runs: Sequence[Run]) -> list[str]:
    return [f"seed {run.record.get('seed')}" for run in runs]


def _folders(runs: Sequence[Run]) -> list[str]:
    return [run.file.parent.name for run in runs]
