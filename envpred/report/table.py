"""A table and its four written forms: Markdown, CSV, LaTeX, HTML."""

import csv
import html
import io
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from envpred.store.files import replace_text

MISSING = "–"
LATEX_SPECIAL = {
    **{character: f"\\{character}" for character in "&%$#_{}"},
    **{"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"},
    **{
        "±": r"$\pm$",
        "×": r"$\times$",
        "†": r"$\dagger$",
        "↑": r"$\uparrow$",
        "↓": r"$\downarrow$",
        "–": "--",
        **{"<": "$<$", ">": "$>$", "|": r"\textbar{}", "≥": r"$\geq$", "→": r"$\to$", "°": r"\textdegree{}"},
    },
}
RAISED = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
SUPERSCRIPTS = re.compile("([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)")
MINUS = re.compile(r"(?<![\w$])-(?=\d)")
# Letters of a row that one column of a paper holds, and those of a cell that is broken into lines.
ONE_COLUMN, LONG_CELL = 52, 34


@dataclass(frozen=True)
class Cell:
    """What stands in a cell: a text, or a `value` with or without its standard errors, all to `digits` decimals.

    With a `drive_error` it is written `value ± drive_error (error)`, where `error` counts windows as independent.
    """

    text: str = ""
    value: float | None = None
    error: float | None = None
    drive_error: float | None = None
    digits: int = 1
    bold: bool = False
    mark: str = ""
    least: bool = False  # a probability: never written as zero

    def plain(self) -> str:
        """The cell as text, without emphasis."""
        if self.value is None:
            return self.text or MISSING
        if not math.isfinite(self.value):
            return MISSING
        drives, windows = (None if e is None or not math.isfinite(e) else f"{e:.{self.digits}f}" for e in self.errors)
        spread = f" ± {windows}" if windows else ""
        if self.drive_error is not None:
            spread = f" ± {drives or MISSING} ({windows or MISSING})"
        least = 10.0**-self.digits
        if self.least and self.value < least:
            return f"< {least:.{self.digits}f}{self.mark}"
        return f"{self.value:.{self.digits}f}{spread}{self.mark}"

    @property
    def errors(self) -> tuple[float | None, float | None]:
        """The standard errors over drives and over windows."""
        return self.drive_error, self.error


@dataclass(frozen=True)
class Table:
    """`rows` under `columns`; `caption` says what a reader must know, `name` is its file's.

    A rule parts off the rows from each of `panels` on, whose numbers are of something else than those above.  A single
    row is no table: it is written as a sentence.
    """

    name: str
    title: str
    caption: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    panels: Sequence[int] = ()

    def __post_init__(self) -> None:
        wrong = [len(row) for row in self.rows if len(row) != len(self.columns)]
        if wrong:
            raise ValueError(f"table {self.name} has {len(self.columns)} columns, but rows of {wrong} cells")

    def sentence(self) -> str:
        """The only row in words: what its first column says, then each title with its cell."""
        ((first, *cells),) = self.rows
        told = "; ".join(f"{title} {cell.plain()}" for title, cell in zip(self.columns[1:], cells, strict=True))
        return f"{first.plain()}: {told}."

    def markdown(self) -> str:
        """The table as GitHub draws it."""
        if len(self.rows) == 1:
            return f"### {self.title}\n\n{self.sentence()}\n\n{self.caption}\n"

        def cell(c: Cell) -> str:
            text = c.plain().replace("|", "\\|").replace("*", "\\*")
            return f"**{text}**" if c.bold else text

        lines = ["| " + " | ".join(self.columns) + " |", "|" + "---|" * len(self.columns)]
        lines += ["| " + " | ".join(cell(c) for c in row) + " |" for row in self.rows]
        return f"### {self.title}\n\n" + "\n".join(lines) + f"\n\n{self.caption}\n"

    def csv(self) -> str:
        """The table with full precision; a column with standard errors is followed by those that hold them."""
        kinds = ("standard error over drives", "standard error over windows")
        having = [
            [any(row[k].errors[n] is not None for row in self.rows) for n in range(len(kinds))]
            for k in range(len(self.columns))
        ]
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        header: list[str] = []
        for title, has in zip(self.columns, having, strict=True):
            header += [title, *(f"{title} {kind}" for kind, told in zip(kinds, has, strict=True) if told)]
        writer.writerow(header)
        for row in self.rows:
            line: list[str] = []
            for c, has in zip(row, having, strict=True):
                line.append(c.text if c.value is None else _number(c.value))
                line += [_number(error) for error, told in zip(c.errors, has, strict=True) if told]
            writer.writerow(line)
        return out.getvalue()

    def latex(self) -> str:
        """The table as a LaTeX `table` with booktabs rules, over both columns of a paper if it is too wide for one."""
        if len(self.rows) == 1:
            said = latex_text(f"{self.sentence()} {self.caption}")
            return f"\\paragraph{{{latex_text(self.title)}.}} {said}\n"

        def cell(c: Cell) -> str:
            text = MINUS.sub("$-$", latex_text(c.plain())) if c.plain()[:1] in "+-0123456789" else latex_text(c.plain())
            return rf"\textbf{{{text}}}" if c.bold else text

        lines = [" & ".join(latex_text(title) for title in self.columns) + r" \\"]
        for n, row in enumerate(self.rows):
            lines += [r"\midrule"] * (n == 0 or n in self.panels)
            lines.append(" & ".join(cell(c) for c in row) + r" \\")
        body = "\n".join(lines)
        widths = [
            max([len(title), *(len(row[k].plain()) for row in self.rows)]) for k, title in enumerate(self.columns)
        ]
        kinds = [
            r"p{0.16\textwidth}" if width > LONG_CELL else "r" if number else "l"
            for width, number in zip(widths, self._numbers(), strict=True)
        ]
        star = "*" * (sum(min(width, LONG_CELL) for width in widths) > ONE_COLUMN)
        return (
            f"\\begin{{table{star}}}\n\\centering\n\\footnotesize\n\\setlength{{\\tabcolsep}}{{3pt}}\n"
            f"\\caption{{{latex_text(self.title)}. {latex_text(self.caption)}}}\n"
            f"\\begin{{tabular}}{{{''.join(kinds)}}}\n\\toprule\n{body}\n\\bottomrule\n"
            f"\\end{{tabular}}\n\\end{{table{star}}}\n"
        )

    def _numbers(self) -> list[bool]:
        """Which columns hold numbers."""
        return [any(row[k].value is not None for row in self.rows) for k in range(len(self.columns))]

    def html(self) -> str:
        """The table as HTML, numbers to the right."""
        if len(self.rows) == 1:
            return f"<p>{html.escape(self.sentence())}</p>\n<p class='caption'>{html.escape(self.caption)}</p>"
        numbers = self._numbers()
        head = "".join(
            f"<th{' class=number' if number else ''}>{html.escape(title)}</th>"
            for title, number in zip(self.columns, numbers, strict=True)
        )

        def cell(c: Cell, number: bool) -> str:
            text = html.escape(c.plain())
            return f"<td{' class=number' if number else ''}>{f'<b>{text}</b>' if c.bold else text}</td>"

        rows = "\n".join(
            f"<tr{' class=panel' * (n in self.panels)}>"
            + "".join(cell(c, number) for c, number in zip(row, numbers, strict=True))
            + "</tr>"
            for n, row in enumerate(self.rows)
        )
        return (
            f'<div class="wide"><table id="{html.escape(self.name)}"><thead><tr>{head}</tr></thead>\n'
            f"<tbody>\n{rows}\n</tbody></table></div>\n<p class='caption'>{html.escape(self.caption)}</p>"
        )


def write_tables(tables: Iterable[Table], out: Path) -> None:
    """Write tables into the folder `out`, each as Markdown, CSV and LaTeX."""
    for table in tables:
        for ending, text in (("md", table.markdown()), ("csv", table.csv()), ("tex", table.latex())):
            replace_text(out / f"{table.name}.{ending}", text)


def latex_text(text: str) -> str:
    """`text` with LaTeX's special characters written out, and superscripts, which may be several, as one."""
    parts = SUPERSCRIPTS.split(text)
    plain = ["".join(LATEX_SPECIAL.get(character, character) for character in part) for part in parts[::2]]
    raised = [f"$^{{{part.translate(RAISED)}}}$" for part in parts[1::2]] + [""]
    return "".join(part for pair in zip(plain, raised, strict=True) for part in pair)


def _number(value: float | None) -> str:
    return "" if value is None or not math.isfinite(value) else f"{value:.6g}"
