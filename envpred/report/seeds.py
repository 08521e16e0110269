"""Runs that differ in their seed alone are one method: their errors are averaged first, their spread is shown."""

import json
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from envpred.metrics.windows import summarise
from envpred.report.run import FloatArray, Measured, Run
from envpred.report.runs import with_distinct_labels
from envpred.report.statistics import drive_errors
from envpred.report.table import Cell, Table
from envpred.report.tables import FACTOR, UNIT, heads, measured_on, shown_columns


def groups(runs: Sequence[Run]) -> list[list[Run]]:
    """Runs in groups that differ in nothing but the seed, in the order of their first; else each by itself."""
    order = {id(run): n for n, run in enumerate(runs)}
    found: dict[str, list[Run]] = {}
    for run in runs:
        found.setdefault(_method(run), []).append(run)
    apart = []
    for group in found.values():
        seeds = [run.record.get("seed") for run in group]
        once = len(set(seeds)) == len(seeds) and None not in seeds
        apart += [group] if once else [[run] for run in group]
    return sorted(apart, key=lambda group: order[id(group[0])])


def average_seeds(runs: Sequence[Run]) -> list[Run]:
    """Each group of `groups` as one run: means over seeds of what was measured in each window.

    Its file is that of the first, and it knows of how many.
    """
    return with_distinct_labels([_averaged(group) if len(group) > 1 else group[0] for group in groups(runs)])


def seeds_table(runs: Sequence[Run]) -> Table | None:
    """How far seeds are apart: standard deviation over seeds of squared error; None if no method has several."""
    several = [group for group in groups(runs) if len(group) > 1]
    if not several:
        return None
    columns, rows = shown_columns(runs[0]), []
    for group in several:
        means = FACTOR * np.stack([run.mse.mean for run in group])
        seeds = ", ".join(str(run.record.get("seed")) for run in group)
        mean, spread = means.mean(axis=0), means.std(axis=0, ddof=1)
        cells = [cell for h in columns for cell in (Cell(value=mean[h]), Cell(value=spread[h], digits=2))]
        rows.append([Cell(group[0].method), Cell(seeds), *cells])
    caption = (
        f"MSE {UNIT} of {measured_on(runs[0])}: mean of the seeds and standard deviation between them. Elsewhere a "
        "method is the mean of its seeds, window by window: that of several trainings, not of a forecaster that "
        "averages several networks."
    )
    titles = ["method", "seeds", *(title for head in heads(runs[0]) for title in (head, f"{head}, deviation"))]
    return Table("seeds", "Spread of the seeds", caption, titles, rows)


def _method(run: Run) -> str:
    """What tells a method from others: all but the seed."""
    model, data = run.record["model"], run.data
    trained: dict[str, Any] = dict(model.get("trained") or {})
    told = {
        "model": [run.name, model.get("class_path"), bool(model.get("untrained")), run.role, run.variant],
        "hyperparameters": {key: value for key, value in model["hyperparameters"].items() if key != "seed"},
        "trained": {key: trained[key] for key in trained.keys() - {"seed", "hyperparameters"}},
        "input": data["input_hash"],
    }
    return json.dumps(told, sort_keys=True, default=str)


def _averaged(group: Sequence[Run]) -> Run:
    """One run of several that differ in their seed."""
    first = group[0]
    keys = [key for key in first.metrics if all(key in run.metrics for run in group)]
    metrics = {key: _mean([run.metrics[key] for run in group], first.drives) for key in keys}
    reliability = first.reliability
    if all(run.reliability is not None for run in group) and reliability is not None:
        reliability = {
            key: _nanmean([run.reliability[key] for run in group if run.reliability is not None]) for key in reliability
        }
    return replace(first, seeds=len(group), metrics=metrics, reliability=reliability)


def _mean(several: Sequence[Measured], drives: Sequence[str]) -> Measured:
    """The mean over seeds of what was measured; without values by window its error is at most that of one seed."""
    first = several[0]
    told = [measured.per_window for measured in several]
    if any(values is None for values in told):
        error = _nanmean([measured.standard_error for measured in several])
        return Measured(_nanmean([measured.mean for measured in several]), error, None, first.about)
    per_window = _nanmean([values for values in told if values is not None])
    all_windows = torch.arange(len(per_window))
    found = summarise(torch.from_numpy(per_window), all_windows, first.about, skip_undefined=True)
    errors = drive_errors(per_window, drives)
    return Measured(found.mean.numpy(), found.standard_error.numpy(), per_window, first.about, errors)


def _nanmean(arrays: Sequence[FloatArray]) -> FloatArray:
    """Mean of what is defined; NaN where nothing is."""
    stacked = np.stack(arrays)
    counted = np.isfinite(stacked)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(counted, stacked, 0).sum(axis=0) / counted.sum(axis=0), np.float64)
