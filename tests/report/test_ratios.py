"""Ratios to the static baseline, beside the paper's, and to the moved last frame."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from envpred.models import FCNForecaster, LastFrame
from envpred.report.ratios import moved_ratio_table, ratio_table
from envpred.report.runs import read_runs

MakeRun = Callable[..., Path]


def test_ratios_beside_the_papers(all_runs: list[Path]) -> None:
    runs = read_runs(all_runs)
    table = ratio_table(runs)
    assert table is not None
    by_label = {row[0].text: row[1:] for row in table.rows}
    ours = by_label["PredNet, DST DOGMa"][3].value
    expected = runs[1].mse.mean[14] / runs[1].metrics["static_mse"].mean[14]
    assert ours == pytest.approx(expected)
    # The ratios that the paper's numbers give.
    for label, ratios in (
        ("PredNet, DST DOGMa", (0.42, 0.39, 0.48, 0.56)),
        ("FCN, probability DOGMa", (0.86, 0.77, 0.78, 0.82)),
        ("Particle filter", (2.32, 1.38, 1.26, 1.21)),
    ):
        assert [cell.value for cell in by_label[label][4:]] == pytest.approx(ratios, abs=0.01)
    assert {cell.plain() for cell in by_label["Moved last frame"][4:]} == {"–"}


@pytest.mark.parametrize("variant", ["dst_static", "prob_static", "dst_dogma"])
def test_the_papers_fcn_read_prob_dogma_alone(make_run: MakeRun, variant: str) -> None:
    table = ratio_table(read_runs([make_run(FCNForecaster, variant, level=0.07)]))
    assert table is not None
    assert {cell.plain() for cell in table.rows[0][5:]} == {"–"}


def test_the_static_baseline_of_any_name_has_the_papers_ratio_of_one(make_run: MakeRun) -> None:
    def renamed(record: dict[str, Any]) -> None:
        record["model"]["name"] = "standstill"

    table = ratio_table(read_runs([make_run(LastFrame, "dst_static", level=0.09, change=renamed)]))
    assert table is not None
    assert [cell.value for cell in table.rows[0][5:]] == [1.0] * 4


def test_ratios_to_the_moved_last_frame(all_runs: list[Path], make_run: MakeRun) -> None:
    runs = read_runs(all_runs)
    table = moved_ratio_table(runs)
    assert table is not None
    assert "Moved last frame" not in [row[0].text for row in table.rows]
    (moved,) = (run for run in runs if run.role == "moved")
    assert table.rows[0][4].value == pytest.approx(runs[0].mse.mean[14] / moved.mse.mean[14])
    assert moved_ratio_table(read_runs([make_run()])) is None
