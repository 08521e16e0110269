"""The tables of squared error: all methods, and the paper's Table I."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from envpred.horizons import SHOWN_S, in_seconds
from envpred.metrics.about import About
from envpred.report.contrasts import AGAINST_STATIC, planned
from envpred.report.published import SOURCE, table_1
from envpred.report.run import Measured, Run
from envpred.report.statistics import LEAST_DRIVES, LEVEL, Comparison, Contrast, compare
from envpred.report.table import Cell, Table
from envpred.results.names import LEARNED, STATIC, method_name

UNIT, FACTOR = "× 10⁻³", 1e3  # in which squared errors are written, ours and the paper's
MSE, STATIC_MSE = "mse", "static_mse"  # keys of squared error in a result, which these tables are about
PREDNET = "prednet"  # the paper's model, as results name it
DAGGER = " †"


def shown_columns(run: Run) -> list[int]:
    """Places of the horizons that tables show: those of Table I, or the last if a run has none of them."""
    places = [int(k) for s in SHOWN_S for k in np.flatnonzero(np.isclose(run.horizon_s, s))]
    return places or [len(run.horizon_s) - 1]


def heads(run: Run) -> list[str]:
    """The titles of their columns."""
    return [in_seconds(run.horizon_s[h]) for h in shown_columns(run)]


def static_of(runs: Sequence[Run]) -> Measured | None:
    """Squared error of the static baseline on the runs' windows, if any run tells it."""
    told = [run.metrics[STATIC_MSE] for run in runs if STATIC_MSE in run.metrics]
    told += [run.mse for run in runs if run.role == "static"]
    return next((measured for measured in told if measured.per_window is not None), None)


def methods(runs: Sequence[Run]) -> dict[str, Measured]:
    """Squared error of each run by its label, and of the static baseline if no run is it."""
    found = {run.label: run.mse for run in runs}
    static = static_of(runs)
    if static is not None and not any(run.role == "static" for run in runs):
        found[STATIC] = static
    return found


def oracles(runs: Sequence[Run]) -> frozenset[str]:
    """Labels of the runs that read the future."""
    return frozenset(run.label for run in runs if run.is_oracle)


def marked(label: str, read_future: Collection[str]) -> str:
    """A label as tables write it: with a dagger if it is one of those that `read_future`."""
    return label + DAGGER if label in read_future else label


def oracle_note(read_future: Collection[str]) -> str:
    """What a caption says of the dagger, if there is one."""
    note = f"{DAGGER} An oracle reads the future: it is a bound, no forecast, and never the best."
    return note if read_future else ""


def measured_on(run: Run) -> str:
    """How many windows and drives are behind a number: `14 windows of 2 drives`."""
    windows, drives = len(run.drives), len(set(run.drives))
    return f"{windows} window{'s' * (windows > 1)} of {drives} drive{'s' * (drives > 1)}"


def errors_note(run: Run) -> str:
    """What captions say of the standard errors of the run's metrics."""
    return f"± standard error over drives (in brackets over windows, as if they were independent); {measured_on(run)}."


def rewards_note(about: About) -> str:
    """What a caption says of what a metric rewards, if it does."""
    return f" {about.rewards}" if about.rewards else ""


def measured_cell(measured: Measured, h: int) -> Cell:
    """The metric's cell at column `h`, written as it says."""
    about = measured.about
    drive = None if measured.drive_error is None else about.factor * measured.drive_error[h]
    value, error = about.factor * measured.mean[h], about.factor * measured.standard_error[h]
    return Cell(value=value, error=error, drive_error=drive, digits=about.digits)


def comparisons(runs: Sequence[Run], more: Sequence[Contrast] = ()) -> list[Comparison]:
    """The planned contrasts among the runs and the static baseline, and `more`, at the shown horizons."""
    values = methods(runs)
    told = {label: measured.per_window for label, measured in values.items() if measured.per_window is not None}
    contrasts = [c for c in (*planned(runs), *more) if c.first in told and c.second in told]
    return compare(told, runs[0].drives, contrasts, shown_columns(runs[0])) if runs else []


def error_table(
    name: str,
    title: str,
    values: Mapping[str, Measured],
    compared: Sequence[Comparison],
    runs: Sequence[Run],
) -> Table:
    """Squared error with standard errors; the best of a horizon bold, a star on what is surely better than static.

    Args:
        name: of the table's files.
        title: of the table.
        values: squared error by label.
        compared: the planned comparisons.
        runs: that are compared; oracles among them are marked and never the best.
    """
    run, read_future = runs[0], oracles(runs)
    columns = shown_columns(run)
    better = {
        (c.contrast.first, c.horizon)
        for c in compared
        if c.contrast.question == AGAINST_STATIC and c.significant() and c.difference < 0
    }
    contenders = [label for label in values if label not in read_future]
    best = {h: min(contenders, key=lambda label: _or_inf(values[label].mean[h]), default="") for h in columns}
    rows = []
    for label, measured in values.items():
        cells = [Cell(marked(label, read_future))]
        for h in columns:
            least = values[best[h]].mean[h] if best[h] else math.inf
            bold = label in contenders and measured.mean[h] == least
            cells.append(replace(measured_cell(measured, h), bold=bold, mark=" *" * ((label, h) in better)))
        rows.append(cells)
    caption = f"MSE of the probability of occupied {UNIT} {errors_note(run)} Lower is better, best bold."
    caption += rewards_note(run.mse.about) + seeds_note([run for run in runs if run.label in values])
    if any(c.contrast.question == AGAINST_STATIC for c in compared):
        caption += " * Better than the static baseline: see the planned comparisons." * bool(better)
        caption += few_drives_note(run)
    caption += oracle_note([label for label in values if label in read_future])
    return Table(name, title, caption, ["method", *heads(run)], rows)


def seeds_note(runs: Sequence[Run]) -> str:
    """Which of the runs are means of several seeds, if any are."""
    several = [f"{run.label} ({run.seeds})" for run in runs if run.seeds > 1]
    return f" Mean over seeds: {', '.join(several)}." if several else ""


def few_drives_note(run: Run) -> str:
    """Why nothing is starred, if there are too few drives to test anything; else nothing."""
    drives = len(set(run.drives))
    if drives >= LEAST_DRIVES:
        return ""
    return (
        f" No star: windows of one drive are alike, and with fewer than {LEAST_DRIVES} drives (here {drives}) no test "
        f"over drives can refuse equality at {LEVEL:.0%} (all differences of one sign: p = {2.0 ** (1 - drives):.2g})."
    )


def _or_inf(value: float) -> float:
    return value if math.isfinite(value) else math.inf


def variants_table(runs: Sequence[Run], compared: Sequence[Comparison]) -> Table | None:
    """Table I: PredNet with each input variant."""
    chosen = {run.label: run.mse for run in runs if run.name == PREDNET}
    if len(chosen) < 2:  # it stands among the methods
        return None
    return error_table("table_1", "PredNet by input variant", chosen, compared, runs)


def methods_table(runs: Sequence[Run], compared: Sequence[Comparison]) -> Table:
    """All methods; `compared` are the `comparisons` of the runs."""
    return error_table("methods", "All methods", methods(runs), compared, runs)


def published_table() -> Table:
    """The paper's Table I, as published."""
    rows = [
        [
            Cell(method_name({"name": PREDNET}, LEARNED, variant)),
            *(Cell(value=FACTOR * m, error=FACTOR * e) for m, e in zip(row.mean, row.standard_error, strict=True)),
        ]
        for variant, row in table_1().items()
    ]
    caption = (
        f"MSE {UNIT} ± standard error over windows; {SOURCE}. Not measured here: other grids, other windows, so "
        "compare orders and ratios with ours, not levels."
    )
    titles = ["method", *map(in_seconds, SHOWN_S)]
    return Table("published_table_1", "The paper's Table I, as published", caption, titles, rows)
