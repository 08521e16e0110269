"""The page of the paper's results: its tables, figures and conclusions, each beside what was published."""

import html
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from envpred.metrics.horizon_mse import MassMSE
from envpred.pictures.forecasts import Camera
from envpred.pictures.grids import save
from envpred.report.contrasts import AGAINST_STATIC, EVIDENCE, VELOCITIES
from envpred.report.curves import error_caption, error_curves
from envpred.report.details import comparisons_table, metric_tables, models_table
from envpred.report.page import Picture, document, measured_data, section
from envpred.report.paragraph import paragraph, write_paragraph
from envpred.report.pictures import compared_scenes, save_strips
from envpred.report.published import CURVE_NAMES, curve_of, table_1
from envpred.report.published import STATIC as PUBLISHED_STATIC
from envpred.report.ratios import ratio_table
from envpred.report.run import Run
from envpred.report.runs import read_runs
from envpred.report.seeds import average_seeds, seeds_table
from envpred.report.statistics import Comparison, Contrast
from envpred.report.table import Cell, Table, write_tables
from envpred.report.tables import (
    FACTOR,
    PREDNET,
    UNIT,
    comparisons,
    few_drives_note,
    heads,
    measured_on,
    methods_table,
    published_table,
    static_of,
    variants_table,
)
from envpred.results.names import LEARNED, method_name
from envpred.store.files import replace_text

PAGE = "paper.html"
AGAINST_FCN = "better than the FCN?"
AGAINST_PARTICLE = "better than the particle filter?"
# What the paper's results say, by the question that tests it: its claim, and the sign of first - second that agrees.
CLAIMS = {
    AGAINST_STATIC: ("PredNet forecasts better than the last grid shown does", -1),
    AGAINST_FCN: ("PredNet forecasts better than the FCN", -1),
    AGAINST_PARTICLE: ("PredNet forecasts better than the particle filter", -1),
    EVIDENCE: ("evidence (DST) serves PredNet better than probability", -1),
    VELOCITIES: ("velocities (DOGMa) serve PredNet better than static grids", 1),
}
NOT_ASKED = "not asked: a method is missing"
FIGURES = {
    "ground": "Ground segmentation",
    "dogma": "Dynamic occupancy grid map",
}


def contrasts(runs: Sequence[Run]) -> list[Contrast]:
    """What the paper's results compare beside what every report does."""
    found = []
    ours = [run.label for run in runs if run.name == PREDNET]
    for question, others in (
        (AGAINST_FCN, [run.label for run in runs if run.name == "fcn"]),
        (AGAINST_PARTICLE, [run.label for run in runs if run.name == "particle_forecast"]),
    ):
        found += [Contrast(label, other, question) for other in others for label in ours]
    return found


def conclusions_table(runs: Sequence[Run], compared: Sequence[Comparison]) -> Table:
    """What becomes of each conclusion of the paper on these windows, at each shown horizon."""
    names = {run.label for run in runs if run.name == PREDNET}
    rows = []
    for question, (claim, sign) in CLAIMS.items():
        asked = [c for c in compared if c.contrast.question == question and c.contrast.first in names]
        for contrast in dict.fromkeys(c.contrast for c in asked):
            cells = [_told(c, sign) for c in asked if c.contrast == contrast]
            rows.append([Cell(claim), Cell(f"{contrast.first} - {contrast.second}"), *cells])
        if not asked:
            rows.append([Cell(claim), Cell(NOT_ASKED), *(Cell() for _ in heads(runs[0]))])
    caption = (
        f"Difference of MSE {UNIT} with its 95 % interval over drives, {measured_on(runs[0])}. Holds: it has the sign "
        "that the paper reports, and the test over drives, corrected for all planned comparisons, refuses equality; "
        f"contrary: the other sign, likewise; open: neither.{few_drives_note(runs[0])}"
    )
    titles = ["conclusion", "difference", *heads(runs[0])]
    return Table("conclusions", "The paper's conclusions", caption, titles, rows)


def missing(runs: Sequence[Run]) -> list[str]:
    """Names of the paper's methods that no run is of."""
    variants = {run.variant for run in runs if run.name == PREDNET}
    found = {curve_of(run.name, run.role, run.variant) for run in runs}
    if static_of(runs) is not None:  # every result tells it
        found.add(PUBLISHED_STATIC)
    lacking = [method_name({"name": PREDNET}, LEARNED, variant) for variant in table_1() if variant not in variants]
    return list(dict.fromkeys([*lacking, *(name for key, name in CURVE_NAMES.items() if key not in found)]))


def _told(found: Comparison, sign: int) -> Cell:
    difference, low, high = (FACTOR * value for value in (found.difference, found.low, found.high))
    spread = f" [{low:.1f}, {high:.1f}]" if np.isfinite(low) else ""
    verdict = "open"
    if found.significant():
        verdict = "holds" if sign * difference > 0 else "contrary"
    return Cell(f"{difference:+.1f}{spread} {verdict}", bold=verdict != "open")


def paper_page(
    results: Sequence[Path],
    out: Path,
    figures: Mapping[str, tuple[Path, str]],
    cameras: Mapping[str, Camera | None],
    about: Sequence[str],
    circles: bool = True,
) -> Path:
    """Write the page of the paper's results into `out`; returns it.

    Args:
        results: of the runs, of the same test windows.
        out: folder.
        figures: files of the `FIGURES`, and what is on them.
        cameras: the camera's pictures, by drive.
        about: paragraphs that say how it was made.
        circles: circle the ego and what moves in strips.

    Raises:
        UserError: as `read_runs`.
    """
    read = read_runs(results)
    runs = average_seeds(read)
    compared = comparisons(runs, contrasts(runs))
    tables = {
        "ours": variants_table(runs, compared),
        "published": published_table(),
        "conclusions": conclusions_table(runs, compared),
        "methods": methods_table(runs, compared),
        "mass": next((table for table in metric_tables(runs) if table.name == MassMSE.name), None),
        "ratios": ratio_table(runs),
        "seeds": seeds_table(read),
        "comparisons": comparisons_table(runs, compared),
        "models": models_table(read, out),
    }
    out.mkdir(parents=True, exist_ok=True)
    write_tables([table for table in tables.values() if table is not None], out)
    text = paragraph(read, compared)
    write_paragraph(text, out)
    curves = error_curves(runs)
    save(curves, out / "error.pdf")
    lacking = missing(runs)
    said = [*about, *([f"No run here is of {'; '.join(lacking)}."] if lacking else []), text]
    parts = ["<h2>Measured on</h2>", measured_data(runs[0]), *(f"<p>{html.escape(t)}</p>" for t in said)]
    ours = _table(tables["ours"], titled=False) or "<p>Fewer than two input variants of PredNet were tested.</p>"
    parts += ["<h2>Table I: PredNet by input variant</h2>", ours]
    parts += ['<div class="published">', _table(tables["published"]), "</div>"]
    parts += ["<h2>Error over the horizon</h2>"]
    parts.append(Picture.read(save(curves, out / "error.png"), error_caption(runs)).html())
    parts += ["<h2>Forecasts</h2>", *(picture.html() for picture in _strips(read, out, cameras, circles))]
    parts += ["<h2>What becomes of the paper's conclusions</h2>", _table(tables["conclusions"], titled=False)]
    for name, heading in FIGURES.items():
        if name in figures:
            file, caption = figures[name]
            parts += [f"<h2>{heading}</h2>", Picture.read(file, caption).html()]
    parts += ["<h2>All methods</h2>", _table(tables["methods"], titled=False)]
    parts += [_table(tables[name]) for name in ("mass", "ratios", "seeds")]
    parts += ["<h2>Details</h2>", *(_table(tables[name]) for name in ("comparisons", "models"))]
    page = document("Dynamic environment prediction: the paper's results, measured again", parts)
    return replace_text(out / PAGE, page)


def _table(table: Table | None, titled: bool = True) -> str:
    return "" if table is None else section(table, titled)


def _strips(runs: Sequence[Run], out: Path, cameras: Mapping[str, Camera | None], circles: bool) -> list[Picture]:
    """The qualitative figure of every window that all runs drew: camera, target, and what each method forecast."""
    pictures = []
    for n, scene in enumerate(compared_scenes(runs)):
        camera = cameras.get(scene.drive)
        seen = camera is not None and any(camera(scene.frames[-1] + h) is not None for h in (0, *scene.shown))
        caption = f"{scene.where}: {'camera, ' * seen}target and forecasts{'; what moves is circled' * circles}"
        caption += "." if seen else "; of its camera there is no picture."
        strips = save_strips(scene, out / f"window_{n}", camera, circles)
        pictures += [Picture.read(strip, caption) for strip in strips]
    return pictures
