"""One self-contained HTML page: tables, curves, pictures and animations, opened from disk without a network."""

import base64
import html
import mimetypes
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from envpred.errors import UserError
from envpred.horizons import in_seconds
from envpred.report.run import Run
from envpred.report.table import Table
from envpred.report.tables import measured_on
from envpred.store.files import inside

LONG = 24  # rows from which a table of the appendix is folded
STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 72em; margin: 2em auto; padding: 0 1em; color: #222; }
h1, h2, h3 { line-height: 1.2; } h2 { margin-top: 2em; border-bottom: 1px solid #ccc; }
table { border-collapse: collapse; margin: .6em 0; font-size: 14px; }
th, td { padding: .25em .7em; border-bottom: 1px solid #ddd; text-align: left; vertical-align: top; }
th { border-bottom: 2px solid #444; } .number { text-align: right; white-space: nowrap; }
.wide { overflow-x: auto; } .caption, figcaption { color: #555; font-size: 13px; max-width: 60em; margin: .2em 0 1em; }
.published { background: #f4f1e8; border-left: 4px solid #e69f00; padding: .2em 1em; }
.panel td { border-top: 2px solid #444; }
figure { margin: 1em 0; } img { max-width: max(100%, 800px); height: auto; } dt, summary { font-weight: 600; }
dd { overflow-wrap: anywhere; }
#models td:last-child { font: 12px ui-monospace, monospace; min-width: 22em; word-break: break-word; }
@page { size: A4; margin: 14mm; }
@media print {
  body { font-size: 10pt; max-width: none; margin: 0; padding: 0; } table { font-size: 8pt; width: 100%; }
  th, td { padding: .15em .3em; } .number { white-space: normal; } .wide { overflow: visible; }
  #models { font-size: 7pt; } #models td:last-child { font-size: 6.5pt; min-width: 0; }
  #models td:nth-last-child(-n+2) { overflow-wrap: anywhere; word-break: normal; }
  img { max-width: 100%; max-height: 245mm; } figure, tr { break-inside: avoid; } thead { display: table-header-group; }
  h2, h3, summary { break-after: avoid; } figcaption, .caption { break-before: avoid; font-size: 9pt; }
}
"""


@dataclass(frozen=True)
class Picture:
    """A picture or animation as the page holds it: `caption` below, `content` of media type `media`."""

    caption: str
    content: bytes
    media: str

    @classmethod
    def read(cls, file: Path, caption: str) -> "Picture":
        """The picture in `file`.

        Raises:
            UserError: if it cannot be read, or is nothing a browser shows.
        """
        media = mimetypes.guess_type(file.name)[0] or ""
        if not media.startswith("image/"):
            raise UserError(f"{file}: not a picture that a browser shows (png, gif, webp, jpg, svg)")
        try:
            return cls(caption, file.read_bytes(), media)
        except OSError as error:
            raise UserError(f"{file}: a result names this picture, but it cannot be read ({error.strerror})") from None

    def html(self) -> str:
        """The picture as a figure, its content in the page."""
        data = base64.b64encode(self.content).decode()
        text = html.escape(self.caption)
        return (
            f'<figure><div class="wide"><img src="data:{self.media};base64,{data}" alt="{text}"></div>'
            f"<figcaption>{text}</figcaption></figure>"
        )


def pictures_of(runs: Sequence[Run]) -> list[Picture]:
    """All pictures that the runs' results name, by paths relative to the result file; their names are captions.

    In the order of their windows.  A run that kept its forecasts is animated beside the others, and not by itself as
    well.
    """
    return [
        Picture.read(inside(run.file.parent, path, run.file), f"{run.label}: {name.replace('_', ' ')}")
        for run in runs
        for name, path in sorted((run.record.get("pictures") or {}).items(), key=lambda item: _natural(item[0]))
        if not (run.record.get("drawn") and str(path).endswith(".gif"))
    ]


def _natural(name: str) -> list[tuple[int, str]]:
    """A key by which `window_2` sorts before `window_10`."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name)]


def page(
    runs: Sequence[Run],
    paragraph: str,
    measured: Sequence[Table],
    published: Sequence[Table],
    appendix: Sequence[Table],
    curves: Mapping[str, Picture],
    compared: Sequence[Picture],
    pictures: Sequence[Picture],
) -> str:
    """The page: `measured` tables, `curves` by heading, `published` tables set apart, pictures, the `appendix`.

    The `paragraph` says how it was measured; `compared` are the pictures that show all methods, `pictures` those of
    single runs.
    """
    parts = ["<h2>Measured on</h2>", measured_data(runs[0]), f"<p>{html.escape(paragraph)}</p>", "<h2>Results</h2>"]
    parts += [section(table) for table in measured]
    parts += [f"<h2>{html.escape(heading)}</h2>{picture.html()}" for heading, picture in curves.items()]
    parts.append('<h2>Published numbers, for comparison</h2><div class="published">')
    parts += [section(table) for table in published]
    parts.append("</div>")
    if compared:
        parts.append("<h2>Forecasts of the same windows</h2>")
        parts += [picture.html() for picture in compared]
    if pictures:
        parts.append("<details><summary>Pictures of each run by itself</summary>")
        parts += [picture.html() for picture in pictures]
        parts.append("</details>")
    parts.append("<h2>Details</h2>")
    parts += [section(table) for table in appendix]
    return document("Forecasts of occupancy, compared on the same windows", parts)


def document(title: str, parts: Sequence[str]) -> str:
    """A page of a `title` and HTML `parts` that needs nothing beside itself."""
    body = "\n".join(parts)
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<link rel="icon" href="data:,"><title>{html.escape(title)}</title><style>{STYLE}</style></head>\n'
        f"<body>\n<h1>{html.escape(title)}</h1>\n{body}\n</body></html>\n"
    )


def section(table: Table, titled: bool = True) -> str:
    """A table under its title, or without if a heading above has said it; a long one is folded."""
    if len(table.rows) > LONG:
        return f"<details><summary>{html.escape(table.title)}</summary>\n{table.html()}</details>"
    return f"<h3>{html.escape(table.title)}</h3>\n{table.html()}" if titled else table.html()


def measured_data(run: Run) -> str:
    """What the runs were measured on."""
    data = run.data
    facts = {
        "test drives": ", ".join(str(drive) for drive in data.get("drives", [])),
        "windows": f"{measured_on(run)} ({data.get('window_rule', 'rule not told')})",
        "frames": f"{data.get('given')} shown, {len(run.horizon_s)} forecast ({in_seconds(run.horizon_s[0])} to "
        f"{in_seconds(run.horizon_s[-1])} ahead)",
        **({"cells": f"{data['resolution']:.3g} m wide"} if "resolution" in data else {}),
        "split": str(data.get("split")),
        "moving cells": f"by {data['movers']}",
        "hash of the grids": str(data.get("store_hash")),
        **{f"warnings about {drive}": "; ".join(lines) for drive, lines in data.get("warnings", {}).items()},
    }
    items = "".join(f"<dt>{html.escape(key)}</dt><dd>{html.escape(value)}</dd>" for key, value in facts.items())
    return f"<dl>{items}</dl>"
