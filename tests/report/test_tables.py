"""The tables of a report."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from envpred.models import FCNForecaster, LastFrame, MovedLastFrame, MovedLastFrameOracle, PredNetForecaster
from envpred.report import published
from envpred.report.details import comparisons_table
from envpred.report.runs import read_runs
from envpred.report.tables import comparisons, methods, methods_table, published_table, variants_table
from tests.report.conftest import DRIVES, WINDOWS

MakeRun = Callable[..., Path]


def test_table_1_has_the_best_bold_and_stars_what_beats_static(all_runs: list[Path]) -> None:
    runs = read_runs(all_runs)
    table = variants_table(runs, comparisons(runs))
    assert table is not None
    assert [row[0].text for row in table.rows] == [
        "PredNet, DST static",
        "PredNet, DST DOGMa",
        "PredNet, probability static",
        "PredNet, probability DOGMa",
    ]
    assert list(table.columns) == ["method", "0.1 s", "0.5 s", "1.0 s", "1.5 s"]
    for column in (1, 2, 3, 4):
        assert [row[column].bold for row in table.rows] == [False, True, False, False]
        assert [row[column].mark for row in table.rows] == [" *"] * 4
    mse = json.loads((all_runs[1] / "result.json").read_text())["metrics"]["mse"]
    cell = table.rows[1][3]
    assert cell.value == pytest.approx(1e3 * mse["mean"][9])
    assert cell.error == pytest.approx(1e3 * mse["standard_error"][9])
    drives = np.array(mse["per_window"])[:, 9].reshape(-1, DRIVES).mean(axis=0)  # windows go round the drives
    assert cell.drive_error == pytest.approx(1e3 * drives.std(ddof=1) / DRIVES**0.5)
    assert f"{WINDOWS} windows of {DRIVES} drives" in table.caption


def test_what_is_no_better_than_static_has_no_star(make_run: MakeRun) -> None:
    runs = read_runs([make_run(level=0.09), make_run(FCNForecaster, "prob_dogma", level=0.2)])
    table = methods_table(runs, comparisons(runs))
    assert not any(cell.mark for row in table.rows for cell in row)


@pytest.mark.parametrize("drives", [1, 2, 5])
def test_few_drives_have_no_star_and_the_caption_says_why(make_run: MakeRun, drives: int) -> None:
    def few(record: dict[str, Any]) -> None:
        windows = record["data"]["windows"]
        record["data"]["windows"] = [[f"drive_{n % drives}", 20 * n] for n in range(len(windows))]

    runs = read_runs([make_run(change=few), make_run(FCNForecaster, "prob_dogma", change=few)])
    compared = comparisons(runs)
    table = methods_table(runs, compared)
    assert compared
    assert not any(cell.mark for row in table.rows for cell in row)
    assert f"with fewer than 6 drives (here {drives}) no test" in table.caption
    assert f"p = {2.0 ** (1 - drives):.2g}" in table.caption
    assert "Better than the static baseline" not in table.caption
    appendix = comparisons_table(runs, compared)
    assert "No star" in appendix.caption
    assert {row[-1].plain() for row in appendix.rows} == {"–"}


def test_static_stands_among_the_methods_once(make_run: MakeRun) -> None:
    runs = read_runs([make_run(), make_run(FCNForecaster, "prob_dogma")])
    assert list(methods(runs)) == ["PredNet, DST static", "FCN, probability DOGMa", "Static"]

    def last_frame(record: dict[str, Any]) -> None:
        record["metrics"]["mse"] = record["metrics"]["static_mse"]

    runs = read_runs([make_run(), make_run(LastFrame, "dst_static", level=1.0, change=last_frame)])
    assert list(methods(runs)) == ["PredNet, DST static", "Static"]


def test_ties_are_both_best(make_run: MakeRun) -> None:
    runs = read_runs([make_run(level=0.05), make_run(PredNetForecaster, "prob_static", level=0.05)])
    table = variants_table(runs, comparisons(runs))
    assert table is not None
    assert all(cell.bold for row in table.rows for cell in row[1:])


def test_an_oracle_is_never_the_best(make_run: MakeRun) -> None:
    runs = read_runs([make_run(), make_run(MovedLastFrameOracle, "dst_static", level=0.01)])
    table = methods_table(runs, comparisons(runs))
    assert [[cell.bold for cell in row[1:]] for row in table.rows] == [[True] * 4, [False] * 4, [False] * 4]
    assert not any(cell.mark for cell in table.rows[1])  # it is better than static, but no forecast
    assert [cell.mark for cell in table.rows[0][1:]] == [" *"] * 4
    assert "An oracle reads the future" in table.caption


def test_roles_tell_what_a_run_is_and_names_do_not(make_run: MakeRun) -> None:
    def named(name: str) -> Callable[[dict[str, Any]], None]:
        return lambda record: record["model"].update(name=name)

    bound = make_run(MovedLastFrameOracle, "dst_static", level=0.01, change=named("foresight"))
    honest = make_run(MovedLastFrame, "dst_static", level=0.05, change=named("no_oracle"))
    still = make_run(LastFrame, "dst_static", level=0.09, change=named("standstill"))
    runs = read_runs([bound, honest, still])
    assert list(methods(runs)) == ["Foresight", "No oracle", "Standstill"]
    table = methods_table(runs, [])
    assert [row[0].text for row in table.rows] == [
        *("Foresight †", "No oracle", "Standstill"),
    ]
    assert [row[1].bold for row in table.rows] == [False, True, False]
    alone = methods_table(runs[:1], [])
    assert not any(cell.bold for cell in alone.rows[0])


def test_table_1_holds_the_papers_model_alone(make_run: MakeRun) -> None:
    like = make_run(change=lambda record: record["model"].update(name="prednet_of_mine"))
    assert variants_table(read_runs([like]), []) is None
    assert variants_table(read_runs([like, make_run()]), []) is None  # one row is no table
    table = variants_table(read_runs([like, make_run(), make_run(PredNetForecaster, "prob_static")]), [])
    assert table is not None
    assert [row[0].text for row in table.rows] == ["PredNet, DST static", "PredNet, probability static"]


def test_published_numbers_are_the_papers() -> None:
    curves = published.curves()
    assert curves["static"].at(1.0) == pytest.approx((0.084107868373394, 0.00472553))
    assert curves["fcn_prob_dogma"].at(0.7) is None
    table = published_table()
    assert [cell.plain() for cell in table.rows[1]] == [
        "PredNet, DST DOGMa",
        "13.4 ± 0.7",
        "25.9 ± 1.2",
        "40.3 ± 1.9",
        "52.2 ± 2.7",
    ]
    assert "Not measured here" in table.caption


def test_published_file_is_the_reference(shared: Path) -> None:
    given = json.loads((shared / "design" / "paper_results.json").read_text())
    shipped = json.loads(Path(published.__file__).with_name("published.json").read_text())
    assert shipped == given
