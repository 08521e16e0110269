"""Tables of ratios: squared error over the static baseline's, and over that of the moved last frame."""

from collections.abc import Sequence

import torch

from envpred.metrics.skill import skill
from envpred.report.published import SOURCE, counterpart
from envpred.report.run import Measured, Run
from envpred.report.statistics import ratio_drive_errors
from envpred.report.table import Cell, Table
from envpred.report.tables import errors_note, heads, marked, oracle_note, oracles, shown_columns, static_of


def ratio_table(runs: Sequence[Run]) -> Table | None:
    """Squared error over the static baseline's on the same windows, beside that ratio of the published numbers."""
    static, published_static = static_of(runs), counterpart("", "static", "")
    if static is None or published_static is None:
        return None
    rows = []
    for run in runs:
        theirs = counterpart(run.name, run.role, run.variant)
        cells = _ratios(run, static)
        for seconds in run.horizon_s[shown_columns(run)]:
            told, base = (curve.at(seconds) if curve else None for curve in (theirs, published_static))
            cells.append(Cell(value=told[0] / base[0], digits=2) if told and base else Cell())
        rows.append([Cell(marked(run.label, oracles(runs))), *cells])
    caption = (
        f"MSE over that of the static baseline (the last grid shown) {errors_note(runs[0])} Below 1 is better than "
        f"static. Right, apart: the same ratio of the numbers {SOURCE}.{oracle_note(oracles(runs))}"
    )
    shown = heads(runs[0])
    titles = ["method", *shown, *(f"paper, {head}" for head in shown)]
    return Table("ratios", "Ratio to the static baseline, ours and the paper's", caption, titles, rows)


def moved_ratio_table(runs: Sequence[Run]) -> Table | None:
    """Squared error over that of the moved last frame on the same windows, None without such a run."""
    moved = next((run for run in runs if run.role == "moved"), None)
    if moved is None or len(runs) == 1:
        return None
    rows = [[Cell(marked(run.label, oracles(runs))), *_ratios(run, moved.mse)] for run in runs if run is not moved]
    caption = (
        f"MSE over that of {moved.label} {errors_note(runs[0])} A method that is not below 1 has "
        f"learned less than the vehicle's own motion.{oracle_note(oracles(runs))}"
    )
    return Table("moved_ratios", "Ratio to the moved last frame", caption, ["method", *heads(runs[0])], rows)


def _ratios(run: Run, reference: Measured) -> list[Cell]:
    """The run's squared error over the reference's at the shown horizons: 1 - skill."""
    assert run.mse.per_window is not None
    assert reference.per_window is not None
    score = skill(torch.from_numpy(run.mse.per_window), torch.from_numpy(reference.per_window))
    ratio, error = (1 - score.value).tolist(), score.standard_error.tolist()
    drive_error = ratio_drive_errors(run.mse.per_window, reference.per_window, run.drives)
    return [Cell(value=ratio[h], error=error[h], drive_error=drive_error[h], digits=2) for h in shown_columns(run)]
