"""Runs that differ in their seed alone."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from envpred.models import FCNForecaster
from envpred.report import report
from envpred.report.runs import read_runs
from envpred.report.seeds import average_seeds, groups, seeds_table
from envpred.report.tables import comparisons, methods_table

MakeRun = Callable[..., Path]


def seeded(seed: int | None, **hyperparameters: object) -> Callable[[dict[str, Any]], None]:
    def change(record: dict[str, Any]) -> None:
        record["seed"] = seed
        record["model"]["hyperparameters"] = {"seed": seed, **hyperparameters}

    return change


def test_seeds_are_averaged_window_by_window(make_run: MakeRun) -> None:
    levels = (0.05, 0.06, 0.07)
    folders = [make_run(level=level, seed=n, change=seeded(n)) for n, level in enumerate(levels)]
    runs = read_runs([*folders, make_run(FCNForecaster, "prob_dogma", change=seeded(0))])
    first, fcn = average_seeds(runs)
    assert (first.label, fcn.label) == ("PredNet, DST static", "FCN, probability DOGMa")
    assert (first.seeds, fcn.seeds) == (3, 1)
    windows = [run.mse.per_window for run in runs[:3]]
    expected = np.mean([values for values in windows if values is not None], axis=0)
    assert first.mse.per_window is not None
    np.testing.assert_allclose(first.mse.per_window, expected)
    np.testing.assert_allclose(first.mse.mean, expected.mean(axis=0))
    np.testing.assert_allclose(first.mse.standard_error, expected.std(axis=0, ddof=1) / np.sqrt(len(expected)))
    assert first.mse.drive_error is not None
    skills = [run.metrics["skill"].mean for run in runs[:3]]
    np.testing.assert_allclose(first.metrics["skill"].mean, np.mean(skills, axis=0))
    table = seeds_table(runs)
    assert table is not None
    (row,) = table.rows
    assert row[1].text == "0, 1, 2"
    means = 1e3 * np.array([run.mse.mean[14] for run in runs[:3]])
    assert row[-2].value == pytest.approx(means.mean())
    assert row[-1].value == pytest.approx(means.std(ddof=1))


def test_more_seeds_are_no_more_comparisons(make_run: MakeRun) -> None:
    one = read_runs([make_run(change=seeded(0))])
    many = average_seeds(read_runs([make_run(seed=n, change=seeded(n)) for n in range(5)]))
    assert len(comparisons(many)) == len(comparisons(one))
    assert all(c.significant() for c in comparisons(many))
    assert len(methods_table(many, []).rows) == 2


def test_what_differs_otherwise_stays_apart(make_run: MakeRun) -> None:
    runs = read_runs(
        [
            make_run(change=seeded(0, channels=[16])),
            make_run(change=seeded(1, channels=[32])),
            make_run(change=seeded(0, channels=[16])),  # tested twice, not trained twice
            make_run(change=seeded(None)),
            make_run(change=seeded(None)),
        ]
    )
    assert [len(group) for group in groups(runs)] == [1] * 5
    assert seeds_table(runs) is None
    assert [run.label for run in average_seeds(runs)] == [run.label for run in runs]


def test_the_report_shows_methods_and_every_run_behind_them(make_run: MakeRun, tmp_path: Path) -> None:
    report([make_run(seed=n, change=seeded(n)) for n in (1, 2)], tmp_path / "out")
    methods = (tmp_path / "out" / "methods.md").read_text(encoding="utf-8")
    assert "| PredNet, DST static |" in methods
    assert "Mean over seeds: PredNet, DST static (2)." in methods
    assert "seed 1" not in methods
    assert "1, 2" in (tmp_path / "out" / "seeds.md").read_text(encoding="utf-8")
    models = (tmp_path / "out" / "models.md").read_text(encoding="utf-8")
    assert "PredNet, DST static, seed 1" in models
    assert "PredNet, DST static, seed 2" in models
