"""The tables behind the results: one for each further metric, the comparisons of all pairs, and what the runs were."""

import math
from collections.abc import Sequence

import numpy as np

from envpred.horizons import in_seconds
from envpred.metrics.about import About
from envpred.metrics.cells import KINDS, key_of
from envpred.report.run import Measured, Run
from envpred.report.statistics import Comparison
from envpred.report.table import Cell, Table
from envpred.report.tables import (
    FACTOR,
    LEVEL,
    MSE,
    STATIC_MSE,
    UNIT,
    heads,
    marked,
    oracle_note,
    oracles,
    shown_columns,
)

ARROWS = {"lower": "↓", "higher": "↑"}


def heading(about: About) -> str:
    """A metric's title with its unit, and which way is better: `Image similarity (cells) ↓`."""
    unit = f"({about.unit})" if about.unit and not about.unit.startswith("×") else about.unit
    better = ARROWS.get(str(about.direction)) or f"(best: {about.direction:g})"
    return " ".join(part for part in (about.title, unit, better) if part)


def metric_tables(runs: Sequence[Run]) -> list[Table]:
    """One table for each metric beside squared error that any run has, written as the result says.

    A metric over kinds of cells stands below the same over all cells, in its table; what no run has a number of is left
    out.
    """
    tables, read_future = [], oracles(runs)
    told = list(dict.fromkeys(key for run in runs for key in run.metrics if key not in (MSE, STATIC_MSE)))
    kinds = {key_of(key, kind): kind for key in told for kind in KINDS}
    for key in (key for key in told if key not in kinds):
        rows: list[list[Cell]] = []
        having: list[Run] = []
        for part in (key, *(key_of(key, kind) for kind in KINDS)):
            of = f", {kinds[part]} cells" if part in kinds else ""
            found = [run for run in runs if part in run.metrics]
            if any(np.isfinite(run.metrics[part].mean).any() for run in found):
                rows += [[Cell(marked(run.label, read_future) + of), *_cells(run, run.metrics[part])] for run in found]
                having += found
        if rows:
            caption = f"Value ± standard error over the windows in which it is defined.{oracle_note(oracles(having))}"
            title = heading(having[0].metrics[key].about)
            tables.append(Table(key, title, caption, ["method", *heads(runs[0])], rows))
    return tables


def _cells(run: Run, measured: Measured) -> list[Cell]:
    factor, digits = measured.about.factor, measured.about.digits
    return [
        Cell(value=factor * measured.mean[h], error=factor * measured.standard_error[h], digits=digits)
        for h in shown_columns(run)
    ]


def pairs_table(runs: Sequence[Run], pairs: Sequence[Comparison]) -> Table:
    """Every pair of methods at the shown horizons."""
    horizon_s, read_future = runs[0].horizon_s, oracles(runs)
    rows = [
        [
            Cell(marked(pair.first, read_future)),
            Cell(marked(pair.second, read_future)),
            Cell(in_seconds(horizon_s[pair.horizon])),
            Cell(value=FACTOR * pair.difference, digits=2),
            Cell(value=FACTOR * pair.low, digits=2),
            Cell(value=FACTOR * pair.high, digits=2),
            Cell(value=pair.p, digits=4, least=True),
            Cell(value=pair.p_holm, digits=4, least=True, bold=pair.significant(LEVEL)),
        ]
        for pair in pairs
    ]
    caption = (
        f"Difference of MSE {UNIT} (first - second) over the same windows, 95 % bootstrap interval (BCa), Wilcoxon "
        f"signed-rank p and p after Holm's correction for {len(pairs)} comparisons (bold below {LEVEL})."
        f"{oracle_note(read_future)}"
    )
    titles = ["first", "second", "horizon", "difference", "low", "high", "p", "p corrected"]
    return Table("pairs", "Pairwise comparisons", caption, titles, rows)


def models_table(runs: Sequence[Run]) -> Table:
    """What each run was: role, size, work, speed, and the command behind it."""
    rows = []
    for run in runs:
        model, seconds = run.record["model"], run.record.get("forecast_seconds_per_window")
        flops, seed = model.get("flops"), run.record.get("seed")
        rows.append(
            [
                Cell(marked(run.label, oracles(runs))),
                Cell(run.role),
                Cell(f"{model['parameters']:,}"),
                Cell(value=flops / 1e9 if flops is not None else math.nan, digits=2),
                Cell(value=1 / seconds if seconds else math.nan, digits=1),
                Cell(str(seed) if seed is not None else ""),
                Cell(str(run.record.get("revision") or "")[:12]),
                Cell(str(run.record.get("command") or "")),
            ]
        )
    caption = (
        "FLOPs of the forecast of one window, a multiply-add counted as two; windows a second in the test run."
        f"{oracle_note(oracles(runs))}"
    )
    titles = ["method", "role", "parameters", "GFLOP a window", "windows/s", "seed", "revision", "command"]
    return Table("models", "Models", caption, titles, rows)
