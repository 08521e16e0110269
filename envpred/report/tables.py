"""The tables of squared error: all methods, and the paper's Table I."""

import math
from collections.abc import Collection, Sequence, Set

import numpy as np

from envpred.horizons import SHOWN_S, in_seconds
from envpred.report.published import SOURCE, STATIC, table_1
from envpred.report.run import Measured, Run
from envpred.report.statistics import Comparison, compare_pairs
from envpred.report.table import Cell, Table

LEVEL = 0.05
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


def comparisons(values: dict[str, Measured], columns: Sequence[int]) -> list[Comparison]:
    """All pairs of methods at the shown horizons, corrected for their number."""
    told = {label: measured.per_window for label, measured in values.items() if measured.per_window is not None}
    return compare_pairs(told, columns)


def error_table(
    name: str,
    title: str,
    values: dict[str, Measured],
    pairs: Sequence[Comparison],
    run: Run,
    read_future: Set[str] = frozenset(),
) -> Table:
    """Squared error with standard error; the best of a horizon bold, a star on what is significantly worse.

    Args:
        name: of the table's files.
        title: of the table.
        values: squared error by label.
        pairs: the comparisons among `values`.
        run: any of the runs, for the horizons.
        read_future: labels of the oracles, which are marked and never the best.
    """
    columns = shown_columns(run)
    differs = {frozenset((p.first, p.second)): set[int]() for p in pairs}
    for pair in pairs:
        if pair.significant(LEVEL):
            differs[frozenset((pair.first, pair.second))].add(pair.horizon)
    contenders = [label for label in values if label not in read_future]
    best = {h: min(contenders, key=lambda label: _or_inf(values[label].mean[h]), default="") for h in columns}
    rows = []
    for label, measured in values.items():
        cells = [Cell(marked(label, read_future))]
        for h in columns:
            first = best[h]
            least = values[first].mean[h] if first else math.inf
            worse = measured.mean[h] > least and h in differs.get(frozenset((label, first)), ())
            bold = label in contenders and measured.mean[h] == least
            value, error = FACTOR * measured.mean[h], FACTOR * measured.standard_error[h]
            cells.append(Cell(value=value, error=error, bold=bold, mark=" *" if worse else ""))
        rows.append(cells)
    caption = _error_caption(len(run.data["windows"]), len(pairs)) + oracle_note(read_future & values.keys())
    return Table(name, title, caption, ["method", *heads(run)], rows)


def _or_inf(value: float) -> float:
    return value if math.isfinite(value) else math.inf


def _error_caption(windows: int, pairs: int) -> str:
    caption = (
        f"MSE of the probability of occupied {UNIT} ± standard error over {windows} windows; "
        "lower is better, best bold."
    )
    if pairs:
        caption += (
            f" * significantly worse than the best (Wilcoxon signed-rank test on the same windows, p < {LEVEL} after "
            f"Holm's correction for {pairs} comparisons)."
        )
        smallest = 2.0 ** (1 - windows)  # all differences of one sign
        if smallest * pairs >= LEVEL:
            least = min(1.0, smallest * pairs)
            caption += f" With {windows} windows none can be: the least p is {smallest:.2g}, corrected {least:.2g}."
    return caption


def variants_table(runs: Sequence[Run]) -> Table | None:
    """Table I: PredNet with each input variant."""
    chosen = {run.label: run.mse for run in runs if run.name == PREDNET}
    if not chosen:
        return None
    pairs = comparisons(chosen, shown_columns(runs[0]))
    return error_table("table_1", "Table I: PredNet by input variant", chosen, pairs, runs[0], oracles(runs))


def methods_table(runs: Sequence[Run], pairs: Sequence[Comparison]) -> Table:
    """All methods; `pairs` are the comparisons among `methods(runs)`."""
    return error_table("methods", "All methods", methods(runs), pairs, runs[0], oracles(runs))


def published_table() -> Table:
    """The paper's Table I, as published."""
    rows = [
        [
            Cell(f"PredNet ({variant})"),
            *(Cell(value=FACTOR * m, error=FACTOR * e) for m, e in zip(row.mean, row.standard_error, strict=True)),
        ]
        for variant, row in table_1().items()
    ]
    caption = f"MSE {UNIT} ± standard error; {SOURCE}. Not measured here: other grids, other windows."
    titles = ["method", *map(in_seconds, SHOWN_S)]
    return Table("published_table_1", "The paper's Table I, as published", caption, titles, rows)
