"""What a report writes for LaTeX."""

from pathlib import Path

import pytest

from envpred.report.table import Cell, Table
from tests.report.latex import COMPILER, compiled, malformed

NASTY = Table(
    "t",
    "50 % & more_of ~^\\{}#$ < 3",
    "± × 10⁻³ | ≥ 2° → – †",
    ["a_b", "m² ↑"],
    [[Cell("x|y"), Cell(value=-1.5, bold=True)], [Cell("<script>"), Cell("+1.0 [-2.0, 3.0] open")], [Cell(), Cell()]],
    [1],
)


def files(page: Path) -> list[str]:
    return [file.read_text(encoding="utf-8") for file in sorted(page.parent.glob("*.tex"))]


def test_all_tables_are_well_formed(page: Path) -> None:
    written = files(page)
    assert len(written) > 8
    for text in [*written, NASTY.latex()]:
        assert malformed(text) == [], text
    assert "-1.5" not in NASTY.latex()
    assert r"\textbf{$-$1.5}" in NASTY.latex()
    assert "[$-$2.0, 3.0]" in NASTY.latex()


@pytest.mark.skipif(COMPILER is None, reason="no pdflatex")
def test_all_tables_compile(page: Path, tmp_path: Path) -> None:
    assert compiled([*files(page), NASTY.latex()], tmp_path) == ""


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("10⁻³", "not ASCII"),
        ("{a", "braces"),
        ("10$^-$$^3$", "dollars"),
        ("a < b", "< as a letter"),
        (r"\begin{table} \end{tabular}", "is closed"),
        ("\\begin{tabular}{lr}\na & b \\\\\n1 \\\\\n2 & 3 \\\\\n\\end{tabular}", "2 columns"),
        ("\\begin{tabular}{lr}\na & b \\\\\n1 & 2 \\\\\n\\end{tabular}", "one row"),
    ],
)
def test_what_is_malformed_is_found(text: str, wrong: str) -> None:
    assert any(wrong in found for found in malformed(text))


def test_wide_tables_go_over_both_columns_and_long_cells_are_broken() -> None:
    narrow = Table("t", "", "", ["method", "0.1 s"], [[Cell("a"), Cell(value=1.0)]] * 2)
    wide = Table("t", "", "", ["method", "command"], [[Cell("a" * 30), Cell("b" * 90)]] * 2)
    assert r"\begin{table}" in narrow.latex()
    assert r"\begin{table*}" in wide.latex()
    assert r"{lp{0.16\textwidth}}" in wide.latex()


def test_one_row_is_a_sentence_in_every_form() -> None:
    one = Table(
        "t", "Spread", "Of seeds.", ["method", "0.1 s", "0.5 s"], [[Cell("A, b"), Cell(value=1.0), Cell(value=-2.0)]]
    )
    told = "A, b: 0.1 s 1.0; 0.5 s -2.0."
    assert one.markdown() == f"### Spread\n\n{told}\n\nOf seeds.\n"
    assert one.html() == f"<p>{told}</p>\n<p class='caption'>Of seeds.</p>"
    assert one.latex() == f"\\paragraph{{Spread.}} {told} Of seeds.\n"
    assert one.csv().startswith("method,0.1 s,0.5 s\n")


def test_panels_are_parted_off() -> None:
    text = NASTY.latex()
    assert text.count(r"\midrule") == 2
    assert NASTY.html().count("<tr class=panel>") == 1
