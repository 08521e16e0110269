"""The report as a whole, and its page in a real browser."""

import re
import shutil
from pathlib import Path

import pytest
from PIL import Image

from envpred.report import report
from envpred.report.pictures import compared_scenes
from envpred.report.runs import read_runs
from tests.browser import BROWSER, browse
from tests.report.conftest import MakeRun


@pytest.mark.skipif(BROWSER is None, reason="no browser: install chromium")
def test_page_in_a_browser(page: Path, tmp_path: Path) -> None:
    alone = tmp_path / "elsewhere" / "report.html"
    alone.parent.mkdir()
    shutil.copy(page, alone)  # self-contained: nothing beside it is needed
    seen = browse(alone, tmp_path / "profile")
    captions = [alt for alt, _, _ in seen["images"]]
    lacking = "Without Particle filter, whose test kept no forecasts."
    strip, moving = "target and forecasts.", "what was seen, then target and forecasts."
    assert captions[2:8] == [
        f"{place}: {kind} {lacking}"
        for place in ("drive_0, frame 4", "drive_9, frame 44")
        for kind in (strip, strip, moving)  # seven methods are too many for a page
    ]
    assert captions[8:] == [
        *(f"PredNet, DST static: window {what}" for what in ("2 errors", "2 velocity", "10 velocity")),
        *(f"Particle filter: window {what}" for what in ("2 animation", "2 errors")),
        *(f"Particle filter: window {what} velocity" for what in ("2", "10")),
    ]
    assert all(complete and width > 0 for _, complete, width in seen["images"])
    widths = [width for _, _, width in seen["images"]]
    assert widths[8:] == [90, 90, 90, 80, 90, 90, 90]
    with Image.open(page.with_name("window_0.png")) as still, Image.open(page.with_name("window_0.gif")) as played:
        assert widths[2:5] == [still.width, still.width, played.width]
        assert getattr(played, "n_frames", 1) == 20  # five shown, fifteen forecast
    assert seen["empty"] == 0
    assert seen["wide"] <= 0
    assert seen["loaded"] == []
    headings = {"All methods", "PredNet by input variant", "Reliability", "Models"}
    assert headings | {"Forecasts of the same windows"} <= set(seen["headings"])


@pytest.mark.skipif(BROWSER is None, reason="no browser: install chromium")
def test_figures_scroll_on_a_phone_and_nothing_is_cut_off_in_print(page: Path, tmp_path: Path) -> None:
    alone = tmp_path / "elsewhere" / "report.html"
    alone.parent.mkdir()
    shutil.copy(page, alone)
    phone = browse(alone, tmp_path / "profile", 500)
    assert phone["wide"] <= 0  # figures and tables scroll, the page does not
    assert min(phone["shown"][:4]) >= 700  # seven points remain ten pixels
    assert phone["cut"] >= 8
    printed = browse(alone, tmp_path / "profile", 688, "print")  # what margins leave of A4
    assert printed["cut"] == 0
    assert printed["wide"] <= 0


def test_page_names_nothing_outside_itself(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert not re.findall(r'(?:src|href)="(?!data:)', text)
    assert "@import" not in text
    assert not re.search(r">\s*(nan|None|inf)\b", text)


def test_the_page_shows_every_picture_that_a_result_names(page: Path) -> None:
    """In the order of the windows, without the animation of a run that is animated beside the others."""
    captions = re.findall(r"<figcaption>(.*?)</figcaption>", page.read_text(encoding="utf-8"))
    ends = {label: [c.split(": ")[1] for c in captions if c.startswith(label)] for label in ("PredNet", "Particle")}
    assert ends["PredNet"] == ["window 2 errors", "window 2 velocity", "window 10 velocity"]
    assert ends["Particle"] == ["window 2 animation", *ends["PredNet"]]


def test_same_results_same_report(page: Path, all_runs: list[Path]) -> None:
    assert report(all_runs, page.parent.with_name("again")).read_bytes() == page.read_bytes()


def test_files(page: Path) -> None:
    names = {file.name for file in page.parent.iterdir()}
    tables = ("methods", "table_1", "ratios", "published_table_1", "iou", "comparisons", "models")
    assert {f"{table}.{ending}" for table in tables for ending in ("md", "csv", "tex")} <= names
    assert {"error.png", "error.pdf", "reliability.png", "reliability.pdf", "report.html"} <= names
    assert {f"window_{n}.{ending}" for n in (0, 1) for ending in ("png", "gif")} <= names


def test_fonts_are_embedded_as_journals_want_them(page: Path) -> None:
    for file in page.parent.glob("*.pdf"):
        content = file.read_bytes()
        assert b"/FontFile2" in content  # TrueType
        assert b"/Type3" not in content


def test_figures_have_the_width_of_two_columns(page: Path) -> None:
    files = sorted(page.parent.glob("*.pdf"))
    strips = [f"window_{n}{part}.pdf" for n in (0, 1) for part in ("", "_part_2")]
    assert [file.name for file in files] == ["error.pdf", "reliability.pdf", *strips]
    for file in files:
        box = re.search(rb"/MediaBox \[ ?0 0 ([\d.]+) ([\d.]+) ?\]", file.read_bytes())
        assert box
        assert float(box[1]) / 72 == pytest.approx(7.16, abs=1e-3)
        assert float(box[2]) / 72 < 9.5  # no longer than a page


def test_strips_are_vectors_around_grids_of_one_pixel_a_cell(page: Path) -> None:
    content = (page.parent / "window_0.pdf").read_bytes()
    images = re.findall(rb"<<(?:(?!>>).)*/Subtype /Image.*?>>", content, re.DOTALL)
    sizes = [tuple(sorted(map(int, re.findall(rb"/(?:Width|Height) (\d+)", image)))) for image in images]
    assert sizes.count((16, 16)) >= 1 + 5 * 4  # the last one shown, target and four forecasts at four horizons
    assert all(max(size) <= 256 for size in sizes)  # no rendered panel
    assert b"/Interpolate true" not in content


def _drawn_methods(run: Path) -> list[str]:
    (first, _) = compared_scenes(read_runs([run]))
    return list(first.forecasts)


def test_one_baseline_alone_makes_a_report(all_runs: list[Path], tmp_path: Path) -> None:
    fcn = all_runs[4]
    assert "Static" in _drawn_methods(fcn)  # the baseline is drawn too, where no run is it
    text = report([fcn], tmp_path / "out").read_text(encoding="utf-8")
    assert "FCN, probability DOGMa" in text
    assert not (tmp_path / "out" / "table_1.md").exists()


def test_what_was_odd_about_the_drives_stands_on_the_page(make_run: MakeRun, tmp_path: Path) -> None:
    odd = {"a": ["timestamps.txt: frames <1 s> apart"]}
    run = make_run(change=lambda record: record["data"].update(warnings=odd))
    text = report([run], tmp_path / "out").read_text(encoding="utf-8")
    assert "warnings about a</dt><dd>timestamps.txt: frames &lt;1 s&gt; apart" in text
