"""`sweep.md`: every run of an ablation in one table, and the tables of its reports."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from envpred.gate import read_json, read_text
from envpred.gate.runs import Seconds
from envpred.report.runs import read_run

from .job import SECONDS, Job
from .plan import QUESTIONS
from .rollouts import ROLLOUT, UNCHANGED

SUMMARY = "sweep.md"
SHOWN_S = (0.1, 0.5, 1.0, 1.5)


def summary(jobs: Sequence[Job], reports: Mapping[str, Path], failures: Sequence[str], folder: Path) -> str:
    """The summary of all runs with a result, as Markdown; links are relative to `folder`.

    Errors of different windows or grids cannot be compared; their ratios to the static baseline on the same windows
    can, with care.
    """
    heads = ["run", "seed", "MSE × 10⁻³", *(f"{s:.1f} s / static" for s in SHOWN_S), "mean / static", "minutes", "what"]
    lines = ["# Ablation", "", *_row(heads), "|" + "---|" * len(heads)]
    for job in jobs:
        if job.result.is_file():
            lines += _row(_cells(job))
    lines += ["", "MSE is the mean over all horizons; ratios are to the last frame shown on the same windows."]
    lines += ["", *(f"* failed: {line}" for line in failures)]
    for group, page in reports.items():
        table = read_text(page.parent / "methods.md", "run the same command again").strip()
        lines += ["", f"## {group}", "", f"[report]({os.path.relpath(page, folder)})", "", table]
    return "\n".join(lines) + "\n"


def _cells(job: Job) -> list[str]:
    run = read_run(job.result)
    mse, static = run.mse.mean, run.metrics["static_mse"].mean
    ratios = [float(mse[k] / static[k]) for s in SHOWN_S for k in np.flatnonzero(np.isclose(run.horizon_s, s))]
    told = job.folder / SECONDS
    minutes = f"{read_json(told, Seconds, f'delete {told}') / 60:.1f}" if told.is_file() else ""
    return [
        job.run.name,
        str(run.record.get("seed")),
        f"{1e3 * mse.mean():.2f}",
        *(f"{ratio:.3f}" for ratio in ratios),
        f"{mse.mean() / static.mean():.3f}",
        minutes,
        (QUESTIONS | {ROLLOUT: UNCHANGED.question}).get(job.run.name, ""),
    ]


def _row(cells: Sequence[str]) -> list[str]:
    return ["| " + " | ".join(cells) + " |"]
