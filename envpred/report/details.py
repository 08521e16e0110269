"""The tables behind the results: one for each further metric, the planned comparisons, and what the runs were."""

import math
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from envpred.horizons import in_seconds
from envpred.metrics.about import About
from envpred.metrics.cells import KINDS, key_of
from envpred.report.run import Measured, Run
from envpred.report.statistics import LEVEL, Comparison
from envpred.report.table import Cell, Table
from envpred.report.tables import (
    FACTOR,
    MSE,
    STATIC_MSE,
    UNIT,
    errors_note,
    few_drives_note,
    heads,
    marked,
    measured_cell,
    measured_on,
    oracle_note,
    oracles,
    rewards_note,
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
        panels: list[int] = []
        having: list[Run] = []
        for part in (key, *(key_of(key, kind) for kind in KINDS)):
            of = f", {kinds[part]} cells" if part in kinds else ""
            found = [run for run in runs if part in run.metrics]
            if any(np.isfinite(run.metrics[part].mean).any() for run in found):
                panels += [len(rows)] * bool(rows)
                rows += [[Cell(marked(run.label, read_future) + of), *_cells(run, run.metrics[part])] for run in found]
                having += found
        if rows:
            about = having[0].metrics[key].about
            caption = f"Value {errors_note(runs[0])} Undefined windows do not count.{rewards_note(about)}"
            caption += " Below each rule over other cells: compare within a panel." * bool(panels)
            caption += oracle_note(oracles(having))
            tables.append(Table(key, heading(about), caption, ["method", *heads(runs[0])], rows, panels))
    return tables


def _cells(run: Run, measured: Measured) -> list[Cell]:
    return [measured_cell(measured, h) for h in shown_columns(run)]


def comparisons_table(runs: Sequence[Run], compared: Sequence[Comparison]) -> Table:
    """The planned contrasts at the shown horizons."""
    horizon_s = runs[0].horizon_s
    rows = [
        [
            Cell(c.contrast.question),
            Cell(c.contrast.first),
            Cell(c.contrast.second),
            Cell(in_seconds(horizon_s[c.horizon])),
            Cell(value=FACTOR * c.difference, digits=2),
            Cell(value=FACTOR * c.low, digits=2),
            Cell(value=FACTOR * c.high, digits=2),
            Cell(value=c.p, digits=4, least=True),
            Cell(value=c.p_corrected, digits=4, least=True, bold=c.significant()),
        ]
        for c in compared
    ]
    caption = (
        f"Difference of MSE {UNIT} (first - second), {measured_on(runs[0])}; 95 % interval from the standard error "
        "over drives (Student's t); p of turning round the signs of whole drives, and corrected for all these "
        "comparisons together (largest statistic; Westfall and Young 1993), bold below "
        f"{LEVEL}. Nothing else was tested."
        f"{few_drives_note(runs[0])}"
    )
    titles = ["question", "first", "second", "horizon", "difference", "low", "high", "p", "p corrected"]
    return Table("comparisons", "Planned comparisons", caption, titles, rows)


def models_table(runs: Sequence[Run], out: Path) -> Table:
    """What each run was: role, size, work, speed, its folder seen from `out`, and the command behind it."""
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
                Cell(_place(run, out)),
                Cell(str(run.record.get("command") or "")),
            ]
        )
    caption = (
        "FLOPs of the forecast of one window, a multiply-add counted as two; windows a second in the test run."
        f"{oracle_note(oracles(runs))}"
    )
    titles = ["method", "role", "parameters", "GFLOP a window", "windows/s", "seed", "revision", "folder", "command"]
    return Table("models", "Models", caption, titles, rows)


def _place(run: Run, out: Path) -> str:
    """The run's folder as seen from the folder of the report."""
    return os.path.relpath(run.file.parent.resolve(), out.resolve())
