"""What two results must share to stand in one report; what does not is refused, with the reason."""

from collections.abc import Sequence

import numpy as np

from envpred.errors import UserError
from envpred.report.run import Run

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


def check_comparable(runs: Sequence[Run], same_inputs: bool = True) -> None:
    """Refuse runs not measured on the same windows and moving cells of the same grids, or that read other velocities.

    With `same_inputs` False an array beside what is judged may differ.

    Raises:
        UserError: naming the two files and what differs.
    """
    for run in runs[1:]:
        _check_windows(runs[0], run)
    if same_inputs:
        _check_inputs(runs)


def _check_inputs(runs: Sequence[Run]) -> None:
    """Refuse runs that read other contents of an array beside what is judged: velocities that were built again."""
    known: dict[str, tuple[str, Run]] = {}
    for run in runs:
        for array, content in run.data["input_hash"].items():
            told, first = known.setdefault(array, (content, run))
            if told != content:
                raise UserError(
                    f"{run.file}: read another {array} (built again since, or another store) than {first.file}; "
                    "run `envpred test` again for both"
                )


def _check_windows(first: Run, other: Run) -> None:
    """Refuse two runs that were not measured on the same windows of the same grids, or judge other cells as moving."""
    here, there = first.data["movers"], other.data["movers"]
    if here != there:
        raise UserError(
            f"{other.file}: takes for moving what {there} say, {first.file} what {here} say, so that their numbers are "
            "of other cells; run `envpred test --data.movers labels` again for both"
        )
    for key, what in SAME_DATA.items():
        here, there = first.data.get(key), other.data.get(key)
        if here != there:
            stale = " (built again since, or another store)" if key == "store_hash" else ""
            shown = "" if key in ("windows", "store_hash") else f": {there} against {here}"
            raise UserError(
                f"{other.file}: other {what}{shown}{stale} than {first.file}; "
                "a report compares runs on the same windows: test both on the same data, or report them apart"
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
