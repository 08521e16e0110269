"""The tables of a report."""

import csv
import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from envpred.report import published
from envpred.report.runs import read_runs
from envpred.report.table import Cell, Table
from envpred.report.tables import (
    comparisons,
    methods,
    methods_table,
    models_table,
    moved_ratio_table,
    other_tables,
    pairs_table,
    published_table,
    ratio_table,
    shown_columns,
    variants_table,
)

MakeRun = Callable[..., Path]
TABLE = Table(
    "t",
    "50 % & more",
    "a_b",
    ["method", "0.1 s"],
    [[Cell("a|b_c"), Cell(value=1.25, error=0.5, bold=True)], [Cell("x"), Cell()]],
)


def test_written_forms() -> None:
    assert TABLE.markdown().splitlines()[2:6] == [
        "| method | 0.1 s |",
        "|---|---|",
        "| a\\|b_c | **1.2 ± 0.5** |",
        "| x | – |",
    ]
    assert list(csv.reader(io.StringIO(TABLE.csv()))) == [
        ["method", "0.1 s", "0.1 s standard error"],
        ["a|b_c", "1.25", "0.5"],
        ["x", "", ""],
    ]
    assert r"\caption{50 \% \& more. a\_b}" in TABLE.latex()
    assert r"a|b\_c & \textbf{1.2 $\pm$ 0.5} \\" in TABLE.latex()
    assert r"\begin{tabular}{lr}" in TABLE.latex()
    assert "<td>a|b_c</td><td class=number><b>1.2 ± 0.5</b></td>" in TABLE.html()
    assert [Cell(value=p, digits=4, least=True).plain() for p in (2e-9, 0.0312)] == ["< 0.0001", "0.0312"]
    assert Cell("<script>").plain() == "<script>"
    assert "&lt;script&gt;" in Table("t", "", "", ["a"], [[Cell("<script>")]]).html()


def test_rows_must_fit() -> None:
    with pytest.raises(ValueError, match="2 columns"):
        Table("t", "", "", ["a", "b"], [[Cell("x")]])


def test_table_1_has_the_best_bold_and_what_is_worse_marked(all_runs: list[Path]) -> None:
    runs = read_runs(all_runs)
    table = variants_table(runs)
    assert table is not None
    assert [row[0].text for row in table.rows] == [
        "prednet (dst_static)",
        "prednet (dst_dogma)",
        "prednet (prob_static)",
        "prednet (prob_dogma)",
    ]
    assert list(table.columns) == ["method", "0.1 s", "0.5 s", "1.0 s", "1.5 s"]
    for column in (1, 2, 3, 4):
        assert [row[column].bold for row in table.rows] == [False, True, False, False]
        assert [row[column].mark for row in table.rows] == [" *", "", " *", " *"]
    record = json.loads((all_runs[1] / "result.json").read_text())["metrics"]["mse"]
    assert table.rows[1][3].value == pytest.approx(1e3 * record["mean"][9])
    assert table.rows[1][3].error == pytest.approx(1e3 * record["standard_error"][9])
    assert "24 comparisons" in table.caption


def test_methods_that_cannot_be_told_apart_are_not_marked(make_run: MakeRun) -> None:
    runs = read_runs([make_run(seed=1), make_run("prednet", "prob_static", seed=2)])
    table = variants_table(runs)
    assert table is not None
    assert not any(cell.mark for row in table.rows for cell in row)


def test_few_windows_say_that_nothing_can_be_significant(make_run: MakeRun) -> None:
    def few(record: dict[str, Any]) -> None:
        record["data"]["windows"] = record["data"]["windows"][:4]
        for key in ("mse", "static_mse", "iou"):
            values = record["metrics"][key]["per_window"][:4]
            mean = [sum(column) / 4 for column in zip(*values, strict=True)]
            record["metrics"][key] |= {"per_window": values, "mean": mean}

    runs = read_runs([make_run(change=few), make_run("fcn", "prob_dogma", change=few)])
    pairs = comparisons(methods(runs), shown_columns(runs[0]))
    table = methods_table(runs, pairs)
    assert not any(cell.mark for row in table.rows for cell in row)
    assert "none can be: the least p is 0.12, corrected 1." in table.caption


def test_static_stands_among_the_methods_once(make_run: MakeRun) -> None:
    runs = read_runs([make_run(), make_run("fcn", "prob_dogma")])
    assert list(methods(runs)) == ["prednet (dst_static)", "fcn (prob_dogma)", "static"]

    def last_frame(record: dict[str, Any]) -> None:
        record["metrics"]["mse"] = record["metrics"]["static_mse"]

    runs = read_runs([make_run(), make_run("last_frame", "dst_static", level=1.0, change=last_frame)])
    assert list(methods(runs)) == ["prednet (dst_static)", "last_frame (dst_static)"]


def test_ratios_beside_the_papers(all_runs: list[Path]) -> None:
    runs = read_runs(all_runs)
    table = ratio_table(runs)
    assert table is not None
    by_label = {row[0].text: row[1:] for row in table.rows}
    ours = by_label["prednet (dst_dogma)"][3].value
    expected = runs[1].mse.mean[14] / runs[1].metrics["static_mse"].mean[14]
    assert ours == pytest.approx(expected)
    # The ratios that the paper's numbers give.
    for label, ratios in (
        ("prednet (dst_dogma)", (0.42, 0.39, 0.48, 0.56)),
        ("fcn (prob_dogma)", (0.86, 0.77, 0.78, 0.82)),
        ("particle_filter (dst_dogma)", (2.32, 1.38, 1.26, 1.21)),
    ):
        assert [cell.value for cell in by_label[label][4:]] == pytest.approx(ratios, abs=0.01)
    assert {cell.plain() for cell in by_label["moved_last_frame (prob_static)"][4:]} == {"–"}


def test_ratios_to_the_moved_last_frame(all_runs: list[Path], make_run: MakeRun) -> None:
    runs = read_runs(all_runs)
    table = moved_ratio_table(runs)
    assert table is not None
    assert "moved_last_frame (prob_static)" not in [row[0].text for row in table.rows]
    (moved,) = (run for run in runs if run.name == "moved_last_frame")
    assert table.rows[0][4].value == pytest.approx(runs[0].mse.mean[14] / moved.mse.mean[14])
    assert moved_ratio_table(read_runs([make_run()])) is None


def test_ties_are_both_best(make_run: MakeRun) -> None:
    table = variants_table(read_runs([make_run(level=0.05), make_run("prednet", "prob_static", level=0.05)]))
    assert table is not None
    assert all(cell.bold for row in table.rows for cell in row[1:])


def test_an_oracle_is_never_the_best(make_run: MakeRun) -> None:
    runs = read_runs([make_run(), make_run("moved_last_frame_oracle", "dst_static", level=0.01)])
    table = methods_table(runs, comparisons(methods(runs), shown_columns(runs[0])))
    assert [[cell.bold for cell in row[1:]] for row in table.rows] == [[True] * 4, [False] * 4, [False] * 4]
    assert "An oracle reads the future" in table.caption


def test_published_numbers_are_the_papers() -> None:
    curves = published.curves()
    assert curves["static"].at(1.0) == pytest.approx((0.084107868373394, 0.00472553))
    assert curves["fcn_prob_dogma"].at(0.7) is None
    table = published_table()
    assert [cell.plain() for cell in table.rows[1]] == [
        "PredNet (dst_dogma)",
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


def test_other_tables_pairs_and_models(all_runs: list[Path]) -> None:
    runs = read_runs(all_runs)
    (iou,) = other_tables(runs)
    assert iou.name == "iou"
    assert iou.rows[0][2].value == pytest.approx(runs[0].metrics["iou"].mean[4])
    pairs = comparisons(methods(runs), shown_columns(runs[0]))
    table = pairs_table(runs, pairs)
    assert len(table.rows) == 8 * 7 / 2 * 4
    first = table.rows[0]
    assert (first[0].text, first[1].text, first[2].text) == ("prednet (dst_static)", "prednet (dst_dogma)", "0.1 s")
    low, difference, high = first[4].value, first[3].value, first[5].value
    assert low is not None
    assert high is not None
    assert difference is not None
    assert 0 < low < difference < high
    models = models_table(runs)
    assert [cell.plain() for cell in models.rows[0]] == [
        "prednet (dst_static)",
        "123,456",
        "25.00",
        "4.0",
        "3",
        "0123456789ab",
        "envpred test --config configs/model/prednet.yaml --data.variant dst_static",
    ]
    assert models.rows[4][2].plain() == "–"
