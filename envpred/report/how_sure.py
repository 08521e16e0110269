"""The tables of how sure forecasts are: spread of samples against skill, and the best of k of them beside the mean."""

from collections.abc import Sequence

import numpy as np
import torch

from envpred.metrics.best_of_k import BestOfK
from envpred.metrics.cells import KINDS, key_of
from envpred.metrics.ratios import ratio_of_means
from envpred.metrics.spread_skill import SpreadSkill
from envpred.report.run import Measured, Run
from envpred.report.statistics import ratio_drive_errors
from envpred.report.table import Cell, Table
from envpred.report.tables import errors_note, heads, marked, measured_on, oracle_note, oracles, shown_columns

SPREAD, BEST, MEAN = SpreadSkill.name, BestOfK.name, "mse"
# What the table by kinds of cells shows beside each other, by key: their columns.
SCORES = {
    MEAN: "MSE of the mean",
    BEST: "of the best",
    SPREAD: "spread / skill",
    "crps": "CRPS",
    "brier": "Brier",
    "ece": "calibration error",
}

# What moving cells are, by what says so.
MOVERS = {
    "labels": "Moving ones lie within a metre of what has moved, within half a second, into a place that was free.",
    "tracklets": "Moving ones lie within a metre of boxes of tracked objects that move over ground, static ones not.",
}


def has_samples(run: Run) -> bool:
    """Whether the spread of the run's forecasts is known."""
    return SPREAD in run.metrics and bool(np.isfinite(run.metrics[SPREAD].mean).any())


def how_sure_table(runs: Sequence[Run]) -> Table | None:
    """Spread over skill, and squared error of the best of k samples over the mean's; None if no run has samples."""
    sampled = next((run for run in runs if has_samples(run)), None)
    if sampled is None:
        return None
    best = sampled.metrics[BEST].about.title.removeprefix("MSE, ")
    rows = [[Cell(marked(run.label, oracles(runs))), *_spread(run), *_best(run)] for run in runs]
    caption = (
        "Left, variance of the samples times (K + 1)/K over squared error of their mean, ± standard error over "
        f"windows: 1 is calibrated, less is too sure of itself. Right, MSE of the {best} samples of each window over "
        f"that of the forecast, which is their mean, {errors_note(runs[0])} One sample of a calibrated forecast has 2. "
        f"A forecast without samples is its own best, and has no spread.{oracle_note(oracles(runs))}"
    )
    shown = heads(runs[0])
    titles = ["method", *(f"spread / skill, {head}" for head in shown), *(f"{best} / mean, {head}" for head in shown)]
    return Table("how_sure", "How sure", caption, titles, rows)


def cells_table(runs: Sequence[Run]) -> Table | None:
    """Scores of the mean and of the samples by kind of cells, at the last shown horizon; None without samples."""
    if not any(has_samples(run) for run in runs):
        return None
    h = shown_columns(runs[0])[-1]
    rows = []
    for kind in ("all", *KINDS):
        for run in runs:
            keys = [score if kind == "all" else key_of(score, kind) for score in SCORES]
            cells = [_cell(run.metrics.get(key), h) for key in keys]
            rows.append([Cell(kind), Cell(marked(run.label, oracles(runs))), *cells])
    caption = (
        f"At {heads(runs[0])[-1]}, {measured_on(runs[0])}; MSE and CRPS × 10⁻³, lower is better but for spread / "
        "skill, best at 1. Changed and static cells were measured both in the last frame shown and then, at the same "
        "place in the world: occupied in one of the two alone, or the same in both. "
        f"{MOVERS[runs[0].data['movers']]} Entering ones are not covered by the last grid shown. All but these are "
        "chosen by what happened, where a calibrated forecast looks too sure: their numbers compare methods, and judge "
        "none. Brier score and calibration error are over the cells measured in the target's frame. "
        f"CRPS of a forecast without samples is its absolute error.{oracle_note(oracles(runs))}"
    )
    panels = range(len(runs), len(rows), len(runs))
    titles = ["cells", "method", *SCORES.values()]
    return Table("how_sure_cells", "How sure, by kind of cells", caption, titles, rows, panels)


def _cell(measured: Measured | None, h: int) -> Cell:
    if measured is None:
        return Cell()
    return Cell(value=measured.about.factor * measured.mean[h], digits=measured.about.digits)


def _spread(run: Run) -> list[Cell]:
    measured = run.metrics.get(SPREAD)
    if measured is None:
        return [Cell() for _ in shown_columns(run)]
    return [
        Cell(value=measured.mean[h], error=measured.standard_error[h], digits=measured.about.digits)
        for h in shown_columns(run)
    ]


def _best(run: Run) -> list[Cell]:
    """Squared error of the best over the mean's, a ratio of means over the windows."""
    best = run.metrics.get(BEST)
    if best is None or best.per_window is None or run.mse.per_window is None:
        return [Cell() for _ in shown_columns(run)]
    ratio, error = ratio_of_means(torch.from_numpy(best.per_window), torch.from_numpy(run.mse.per_window), True)
    drive_error = ratio_drive_errors(best.per_window, run.mse.per_window, run.drives)
    return [
        Cell(value=float(ratio[h]), error=float(error[h]), drive_error=drive_error[h], digits=2)
        for h in shown_columns(run)
    ]
