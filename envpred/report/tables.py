"""The tables of a report, from its runs."""

import math
from collections.abc import Sequence

import numpy as np
import torch

from envpred.metrics.skill import skill
from envpred.report.published import SOURCE, STATIC, counterpart, table_1
from envpred.report.runs import Measured, Run
from envpred.report.statistics import Comparison, compare_pairs
from envpred.report.table import Cell, Table

SHOWN_S = (0.1, 0.5, 1.0, 1.5)  # horizons of the paper's Table I
LEVEL = 0.05
UNIT = "× 10⁻³"

# Metrics beside squared error: key in a result, title, decimals, factor.
OTHER_METRICS = (
    ("mse_dynamic_cells", f"MSE, dynamic cells {UNIT} ↓", 1, 1e3),
    ("mse_static_cells", f"MSE, static cells {UNIT} ↓", 1, 1e3),
    ("image_similarity", "Image similarity (cells) ↓", 2, 1.0),
    ("image_similarity_occupied", "Image similarity, occupied (cells) ↓", 2, 1.0),
    ("image_similarity_free", "Image similarity, free (cells) ↓", 2, 1.0),
    ("image_similarity_unknown", "Image similarity, unknown (cells) ↓", 2, 1.0),
    ("iou", "IoU at 0.5 ↑", 3, 1.0),
    ("precision", "Precision at 0.5 ↑", 3, 1.0),
    ("recall", "Recall at 0.5 ↑", 3, 1.0),
    ("roc_auc", "ROC area ↑", 3, 1.0),
    ("brier", "Brier score ↓", 3, 1.0),
    ("ece", "Calibration error ↓", 3, 1.0),
    ("motion_ratio", "Motion ratio (best: 1)", 2, 1.0),
)


def shown_columns(run: Run) -> list[int]:
    """Places of the horizons that tables show: those of Table I, or the last if a run ends before."""
    places = [int(k) for s in SHOWN_S for k in np.flatnonzero(np.isclose(run.horizon_s, s))]
    return places or [len(run.horizon_s) - 1]


def static_of(runs: Sequence[Run]) -> Measured | None:
    """Squared error of the static baseline on the runs' windows, if any run tells it."""
    told = [run.metrics["static_mse"] for run in runs if "static_mse" in run.metrics]
    told += [run.mse for run in runs if run.name == "last_frame"]
    return next((measured for measured in told if measured.per_window is not None), None)


def methods(runs: Sequence[Run]) -> dict[str, Measured]:
    """Squared error of each run by its label, and of the static baseline if no run is it."""
    found = {run.label: run.mse for run in runs}
    static = static_of(runs)
    if static is not None and not any(run.name == "last_frame" for run in runs):
        found[STATIC] = static
    return found


def comparisons(values: dict[str, Measured], columns: Sequence[int]) -> list[Comparison]:
    """All pairs of methods at the shown horizons, corrected for their number."""
    told = {label: measured.per_window for label, measured in values.items() if measured.per_window is not None}
    return compare_pairs(told, columns)


def error_table(name: str, title: str, values: dict[str, Measured], pairs: Sequence[Comparison], run: Run) -> Table:
    """Squared error with standard error; the best of a horizon bold, a star on what is significantly worse.

    `pairs` are the comparisons among `values`; `run` is any of the runs, for the horizons.
    """
    columns = shown_columns(run)
    differs = {frozenset((p.first, p.second)): set[int]() for p in pairs}
    for pair in pairs:
        if pair.significant(LEVEL):
            differs[frozenset((pair.first, pair.second))].add(pair.horizon)
    contenders = [label for label in values if not is_oracle(label)] or list(values)
    best = {h: min(contenders, key=lambda label: _or_inf(values[label].mean[h])) for h in columns}
    rows = []
    for label, measured in values.items():
        cells = [Cell(label)]
        for h in columns:
            worse = h in differs.get(frozenset((label, best[h])), ())
            cells.append(
                Cell(
                    value=1e3 * measured.mean[h],
                    error=1e3 * measured.standard_error[h],
                    bold=label in contenders and measured.mean[h] == values[best[h]].mean[h],
                    mark=" *" if worse else "",
                )
            )
        rows.append(cells)
    caption = _error_caption(len(run.data["windows"]), len(pairs))
    if len(contenders) < len(values):
        caption += " An oracle reads the future: it is a bound, no forecast, and never the best."
    return Table(name, title, caption, ["method", *_heads(run)], rows)


def is_oracle(label: str) -> bool:
    """Whether a method reads the future, which it then says in its name."""
    return "oracle" in label.split(" ", maxsplit=1)[0]


def _or_inf(value: float) -> float:
    return value if math.isfinite(value) else math.inf


def _heads(run: Run) -> list[str]:
    return [f"{run.horizon_s[h]:.1f} s" for h in shown_columns(run)]


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
    chosen = {run.label: run.mse for run in runs if run.name.startswith("prednet")}
    if not chosen:
        return None
    pairs = comparisons(chosen, shown_columns(runs[0]))
    return error_table("table_1", "Table I: PredNet by input variant", chosen, pairs, runs[0])


def methods_table(runs: Sequence[Run], pairs: Sequence[Comparison]) -> Table:
    """All methods; `pairs` are the comparisons among `methods(runs)`."""
    return error_table("methods", "All methods", methods(runs), pairs, runs[0])


def published_table() -> Table:
    """The paper's Table I, as published."""
    rows = [
        [
            Cell(f"PredNet ({variant})"),
            *(Cell(value=1e3 * m, error=1e3 * e) for m, e in zip(row.mean, row.standard_error, strict=True)),
        ]
        for variant, row in table_1().items()
    ]
    caption = f"MSE {UNIT} ± standard error; {SOURCE}. Not measured here: other grids, other windows."
    titles = ["method", *(f"{s:.1f} s" for s in SHOWN_S)]
    return Table("published_table_1", "The paper's Table I, as published", caption, titles, rows)


def ratio_table(runs: Sequence[Run]) -> Table | None:
    """Squared error over the static baseline's on the same windows, beside that ratio of the published numbers."""
    static, published_static = static_of(runs), counterpart(STATIC, "")
    if static is None or published_static is None:
        return None
    rows = []
    for run in runs:
        theirs = counterpart(run.name, run.variant)
        cells = _ratios(run, static)
        for seconds in run.horizon_s[shown_columns(run)]:
            told, base = (curve.at(seconds) if curve else None for curve in (theirs, published_static))
            cells.append(Cell(value=told[0] / base[0], digits=2) if told and base else Cell())
        rows.append([Cell(run.label), *cells])
    caption = (
        "MSE over that of the static baseline (the last grid shown) on the same windows, ± standard error; below 1 is "
        f"better than static. Right, apart: the same ratio of the numbers {SOURCE}."
    )
    heads = _heads(runs[0])
    titles = ["method", *heads, *(f"paper, {head}" for head in heads)]
    return Table("ratios", "Ratio to the static baseline, ours and the paper's", caption, titles, rows)


def moved_ratio_table(runs: Sequence[Run]) -> Table | None:
    """Squared error over that of the moved last frame on the same windows, None without such a run."""
    moved = next((run for run in runs if run.name == "moved_last_frame"), None)
    if moved is None or len(runs) == 1:
        return None
    rows = [[Cell(run.label), *_ratios(run, moved.mse)] for run in runs if run is not moved]
    caption = (
        f"MSE over that of {moved.label} on the same windows, ± standard error. A method that is not below 1 has "
        "learned less than the vehicle's own motion."
    )
    return Table("moved_ratios", "Ratio to the moved last frame", caption, ["method", *_heads(runs[0])], rows)


def _ratios(run: Run, reference: Measured) -> list[Cell]:
    """The run's squared error over the reference's at the shown horizons: 1 - skill."""
    assert run.mse.per_window is not None
    assert reference.per_window is not None
    score = skill(torch.from_numpy(run.mse.per_window), torch.from_numpy(reference.per_window))
    ratio, error = (1 - score.value).tolist(), score.standard_error.tolist()
    return [Cell(value=ratio[h], error=error[h], digits=2) for h in shown_columns(run)]


def other_tables(runs: Sequence[Run]) -> list[Table]:
    """One table per metric beside squared error that any run has."""
    tables = []
    for key, title, digits, factor in OTHER_METRICS:
        having = [run for run in runs if key in run.metrics]
        if having:
            rows = [[Cell(run.label), *_cells(run, run.metrics[key], digits, factor)] for run in having]
            caption = "Mean ± standard error over windows in which it is defined."
            tables.append(Table(key, title, caption, ["method", *_heads(runs[0])], rows))
    return tables


def _cells(run: Run, measured: Measured, digits: int, factor: float) -> list[Cell]:
    return [
        Cell(value=factor * measured.mean[h], error=factor * measured.standard_error[h], digits=digits)
        for h in shown_columns(run)
    ]


def pairs_table(runs: Sequence[Run], pairs: Sequence[Comparison]) -> Table:
    """Every pair of methods at the shown horizons."""
    horizon_s = runs[0].horizon_s
    rows = [
        [
            Cell(pair.first),
            Cell(pair.second),
            Cell(f"{horizon_s[pair.horizon]:.1f} s"),
            Cell(value=1e3 * pair.difference, digits=2),
            Cell(value=1e3 * pair.low, digits=2),
            Cell(value=1e3 * pair.high, digits=2),
            Cell(value=pair.p, digits=4, least=True),
            Cell(value=pair.p_holm, digits=4, least=True, bold=pair.significant(LEVEL)),
        ]
        for pair in pairs
    ]
    caption = (
        f"Difference of MSE {UNIT} (first - second) over the same windows, 95 % bootstrap interval (BCa), Wilcoxon "
        f"signed-rank p and p after Holm's correction for {len(pairs)} comparisons (bold below {LEVEL})."
    )
    titles = ["first", "second", "horizon", "difference", "low", "high", "p", "p corrected"]
    return Table("pairs", "Pairwise comparisons", caption, titles, rows)


def models_table(runs: Sequence[Run]) -> Table:
    """What each run was: size, work, speed, and the command behind it."""
    rows = []
    for run in runs:
        model, seconds = run.record["model"], run.record.get("forecast_seconds_per_window")
        flops, seed = model.get("flops"), run.record.get("seed")
        rows.append(
            [
                Cell(run.label),
                Cell(f"{model['parameters']:,}"),
                Cell(value=flops / 1e9 if flops is not None else math.nan, digits=2),
                Cell(value=1 / seconds if seconds else math.nan, digits=1),
                Cell(str(seed) if seed is not None else ""),
                Cell(str(run.record.get("revision") or "")[:12]),
                Cell(str(run.record.get("command") or "")),
            ]
        )
    caption = "FLOPs of the forecast of one window, a multiply-add counted as two; windows a second in the test run."
    titles = ["method", "parameters", "GFLOP a window", "windows/s", "seed", "revision", "command"]
    return Table("models", "Models", caption, titles, rows)
