"""A table's written forms."""

import csv
import io
import math

import pytest

from envpred.report.table import Cell, Table, latex_text

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
        ["method", "0.1 s", "0.1 s standard error over windows"],
        ["a|b_c", "1.25", "0.5"],
        ["x", "", ""],
    ]
    assert r"\caption{50 \% \& more. a\_b}" in TABLE.latex()
    assert r"a\textbar{}b\_c & \textbf{1.2 $\pm$ 0.5} \\" in TABLE.latex()
    assert r"\begin{tabular}{lr}" in TABLE.latex()
    assert "<td>a|b_c</td><td class=number><b>1.2 ± 0.5</b></td>" in TABLE.html()
    assert [Cell(value=p, digits=4, least=True).plain() for p in (2e-9, 0.0312)] == ["< 0.0001", "0.0312"]
    assert Cell("<script>").plain() == "<script>"
    assert "&lt;script&gt;" in Table("t", "", "", ["a"], [[Cell("<script>")]]).html()


def test_rows_must_fit() -> None:
    with pytest.raises(ValueError, match="2 columns"):
        Table("t", "", "", ["a", "b"], [[Cell("x")]])


def test_both_standard_errors() -> None:
    cells = [Cell(value=1.25, error=0.5, drive_error=0.75), Cell(value=2.0, error=0.1, drive_error=math.nan), Cell("x")]
    table = Table("t", "T", "", ["0.1 s"], [[cell] for cell in cells])
    assert [row[0].plain() for row in table.rows] == ["1.2 ± 0.8 (0.5)", "2.0 ± – (0.1)", "x"]
    assert list(csv.reader(io.StringIO(table.csv()))) == [
        ["0.1 s", "0.1 s standard error over drives", "0.1 s standard error over windows"],
        ["1.25", "0.75", "0.5"],
        ["2", "", "0.1"],
        ["x", "", ""],
    ]
    assert r"1.2 $\pm$ 0.8 (0.5)" in table.latex()


def test_superscripts_are_raised_together() -> None:
    """Two of them beside each other, each in dollars of its own, are an error of LaTeX's."""
    assert latex_text("10⁻³ m², a_b") == r"10$^{-3}$ m$^{2}$, a\_b"
