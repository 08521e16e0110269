"""From results of test runs alone to tables, curves and one HTML page."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from envpred.pictures.animations import scene_animation
from envpred.pictures.forecasts import Camera
from envpred.pictures.grids import save
from envpred.report.curves import error_caption, error_curves, reliability_diagram
from envpred.report.details import comparisons_table, metric_tables, models_table
from envpred.report.how_sure import cells_table, how_sure_table
from envpred.report.labels import labelled
from envpred.report.page import Picture, page, pictures_of
from envpred.report.paragraph import paragraph, write_paragraph
from envpred.report.pictures import compared_scenes, save_strips
from envpred.report.ratios import moved_ratio_table, ratio_table
from envpred.report.run import Run
from envpred.report.runs import read_runs
from envpred.report.seeds import average_seeds, seeds_table
from envpred.report.table import write_tables
from envpred.report.tables import comparisons, methods_table, published_table, variants_table
from envpred.results.scenes import Scene
from envpred.store.files import replace_text

PAGE = "report.html"


RELIABILITY = (
    "Share of cells that were occupied over the probability forecast for them, in ten bins, over cells that were "
    "measured in the target's frame. On the grey line a forecast means what it says."
)


def report(
    runs: Sequence[Path],
    out: Path,
    same_inputs: bool = True,
    camera: Callable[[str], Camera | None] = lambda drive: None,
    labels: Sequence[str] = (),
    circles: bool = True,
) -> Path:
    """Compare test runs: write tables (Markdown, CSV, LaTeX), figures (PNG, PDF) and `report.html` into `out`.

    Returns the page.  Same results, same report.

    Args:
        runs: result files, or folders that hold some, all of the same test windows.
        out: folder for the report.
        same_inputs: whether runs must have read the same of an array beside what is judged, a velocity say.
        camera: of a drive, for pictures beside the grids.
        labels: `RUN=NAME` each: what to call the method of a run instead of what its result tells.
        circles: circle the ego and what moves in strips.

    Raises:
        UserError: if a result is missing, damaged, partial, stale or of other windows, or a label fits none; nothing is
            written.
    """
    out = Path(out)
    read = labelled(read_runs(runs, same_inputs), labels)
    pictures, scenes = pictures_of(read), compared_scenes(read)
    cameras = {scene.drive: camera(scene.drive) for scene in scenes}
    averaged = average_seeds(read)
    compared = comparisons(averaged)
    tables = (
        *(methods_table(averaged, compared), variants_table(averaged, compared)),
        *(ratio_table(averaged), moved_ratio_table(averaged), seeds_table(read)),
        *(how_sure_table(averaged), cells_table(averaged)),
    )
    measured = [table for table in tables if table is not None]
    compared_table = [comparisons_table(averaged, compared)] if compared else []
    appendix = [*compared_table, *metric_tables(averaged), models_table(read, out)]
    published = [published_table()]
    figures = {"error": ("Error over the horizon", error_caption(averaged), error_curves(averaged))}
    reliability = reliability_diagram(averaged)
    if reliability is not None:
        figures["reliability"] = ("Reliability", RELIABILITY, reliability)

    out.mkdir(parents=True, exist_ok=True)
    write_tables([*measured, *published, *appendix], out)
    text = paragraph(read, compared)
    write_paragraph(text, out)
    curves = {}
    for name, (heading, caption, figure) in figures.items():
        save(figure, out / f"{name}.pdf")
        curves[heading] = Picture.read(save(figure, out / f"{name}.png"), caption)
    drawn = _compared(scenes, read, out, cameras, circles)
    return replace_text(out / PAGE, page(read, text, measured, published, appendix, curves, drawn, pictures))


def _compared(
    scenes: Sequence[Scene], runs: Sequence[Run], out: Path, cameras: Mapping[str, Camera | None], circles: bool
) -> list[Picture]:
    """A strip and an animation of each scene, every method beside the others, written into `out` too."""
    without = [run.label for run in runs if scenes and run.label not in scenes[0].forecasts]
    lacking = f" Without {', '.join(without)}, whose test kept no forecasts." if without else ""
    pictures = []
    for n, scene in enumerate(scenes):
        gif = out / f"window_{n}.gif"
        save(scene_animation(scene), gif)
        strips = save_strips(scene, out / f"window_{n}", cameras[scene.drive], circles)
        pictures += [Picture.read(strip, f"{scene.where}: target and forecasts.{lacking}") for strip in strips]
        pictures.append(Picture.read(gif, f"{scene.where}: what was seen, then target and forecasts.{lacking}"))
    return pictures
