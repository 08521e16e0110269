"""The page of the paper's results."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from envpred.datamodules.variants import VARIANTS
from envpred.models import FCNForecaster, LastFrame, MovedLastFrame, ParticleForecast, PredNetForecaster
from envpred.report import paper as module
from envpred.report.contrasts import AGAINST_STATIC
from envpred.report.paper import (
    AGAINST_FCN,
    AGAINST_PARTICLE,
    CLAIMS,
    NOT_ASKED,
    conclusions_table,
    contrasts,
    paper_page,
)
from envpred.report.run import Run
from envpred.report.runs import read_runs
from envpred.report.statistics import Comparison
from envpred.report.tables import comparisons
from tests.report.conftest import DRAWN_WINDOWS, DRIVES, draw_windows

MakeRun = Callable[..., Path]


@pytest.fixture
def results(make_run: MakeRun) -> list[Path]:
    """Results of the paper's methods: the FCN the best of them, against what it says."""
    folders = [make_run(PredNetForecaster, variant, seed=n) for n, variant in enumerate(VARIANTS)]
    folders.append(make_run(FCNForecaster, "prob_dogma", level=0.02, seed=5))
    folders.append(make_run(LastFrame, "dst_static", level=0.09, seed=6))
    folders.append(make_run(ParticleForecast, "dst_dogma", seed=7))
    folders.append(make_run(MovedLastFrame, "prob_static", seed=8))
    for folder in folders[:2]:
        draw_windows(folder)
    return [folder / "result.json" for folder in folders]


def compared(runs: list[Run]) -> list[Comparison]:
    return comparisons(runs, contrasts(runs))


def test_every_claim_of_the_paper_is_asked(results: list[Path]) -> None:
    runs = read_runs(results)
    questions = {c.contrast.question for c in compared(runs)}
    assert questions >= set(CLAIMS)
    fcn = [c.second for c in contrasts(runs) if c.question == AGAINST_FCN]
    assert fcn == ["FCN, probability DOGMa"] * 4
    assert [c.second for c in contrasts(runs) if c.question == AGAINST_PARTICLE] == ["Particle filter"] * 4


def test_conclusions_hold_stand_open_or_are_contrary(results: list[Path]) -> None:
    runs = read_runs(results)
    table = conclusions_table(runs, compared(runs))
    said = {(row[0].text, row[1].text): row[-1].text for row in table.rows}
    assert len(table.rows) == 4 * 3 + 2 + 2
    (against_static, _), (against_fcn, _) = CLAIMS["better than the static baseline?"], CLAIMS[AGAINST_FCN]
    assert said[against_static, "PredNet, DST DOGMa - Static"].endswith("] holds")
    assert said[against_fcn, "PredNet, DST DOGMa - FCN, probability DOGMa"].endswith("] contrary")
    (evidence, _) = CLAIMS["evidence (DST) against probability"]
    assert said[evidence, "PredNet, DST static - PredNet, probability static"].endswith(
        "] open"
    )  # levels .0520 and .0521
    (velocities, sign) = CLAIMS["static grids against DOGMas"]
    assert sign == 1  # static less DOGMa: positive where velocities help
    assert said[velocities, "PredNet, DST static - PredNet, DST DOGMa"].endswith("] holds")


@pytest.mark.parametrize("drives", [1, 2])
def test_few_drives_leave_all_open(make_run: MakeRun, tmp_path: Path, drives: int) -> None:
    def few(record: dict[str, Any]) -> None:
        record["data"]["windows"] = [[f"drive_{n % drives}", 20 * n] for n in range(len(record["data"]["windows"]))]

    folders = [make_run(change=few), make_run(FCNForecaster, "prob_dogma", level=0.02, change=few)]
    runs = read_runs(folders)
    table = conclusions_table(runs, compared(runs))
    told = [row for row in table.rows if row[1].text != NOT_ASKED]
    assert {cell.text.rsplit(" ", 1)[1] for row in told for cell in row[2:]} == {"open"}
    assert all(("[" in cell.text) == (drives > 1) for row in told for cell in row[2:])  # an interval takes two
    assert f"with fewer than 6 drives (here {drives}) no test" in table.caption
    page = paper_page(folders, tmp_path / "out", {}, {}, []).read_text(encoding="utf-8")
    assert f"With fewer than 6 drives (here {drives}) no difference was tested." in page
    assert ("over the horizon, of one drive without bands." in page) == (drives == 1)


def test_what_is_missing_is_said(make_run: MakeRun, tmp_path: Path) -> None:
    """One input variant, neither FCN nor particle filter: no table of one row, and what cannot be asked is named."""
    folder = make_run(PredNetForecaster, "dst_static")
    page = paper_page([folder], tmp_path / "out", {}, {}, []).read_text(encoding="utf-8")
    assert "Fewer than two input variants of PredNet were tested." in page
    assert (
        "No run here is of PredNet, DST DOGMa; PredNet, probability static; PredNet, probability DOGMa; "
        "FCN, probability DOGMa; Particle filter."
    ) in page
    runs = read_runs([folder])
    asked = {row[0].text: row[1].text for row in conclusions_table(runs, compared(runs)).rows}
    claims = {question: asked[claim] for question, (claim, _) in CLAIMS.items()}
    assert claims.pop(AGAINST_STATIC) == "PredNet, DST static - Static"
    assert set(claims.values()) == {NOT_ASKED}


def test_drives_without_pictures_of_a_camera_are_said(
    results: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    picture = tmp_path / "picture.png"
    Image.new("L", (40, 20)).save(picture)
    monkeypatch.setattr(module, "save_strips", lambda *_: [picture])  # drawing takes longer than all else
    first, last = (f"drive_{window % DRIVES}" for window in DRAWN_WINDOWS)
    page = paper_page(results, tmp_path / "out", {}, {first: lambda _: picture, last: lambda _: None}, [])
    captions = re.findall(r"<figcaption>(drive_.*?)</figcaption>", page.read_text(encoding="utf-8"))
    with_camera, without = captions
    assert with_camera.endswith(": camera, target and forecasts; what moves is circled.")
    assert without.endswith(": target and forecasts; what moves is circled; of its camera there is no picture.")
    assert "No run here is of" not in page.read_text(encoding="utf-8")


def test_page_has_all_parts_and_names_the_runs(results: list[Path], tmp_path: Path) -> None:
    picture = tmp_path / "ground.png"
    picture.write_bytes(b"picture")
    page = paper_page(results, tmp_path / "out", {"ground": (picture, "Two methods.")}, {}, ["Made <here>."])
    text = page.read_text(encoding="utf-8")
    for heading in (
        "Table I: PredNet",
        "Error over the horizon",
        "Forecasts",
        "conclusions",
        "Ground seg",
        "All methods",
    ):
        assert heading in text
    headings = re.findall(r"<h[123]>(.*?)</h[123]>", text)
    assert len(set(headings)) == len(headings)
    assert not [head for head in headings if any(head != other and head in other for other in headings)]
    assert "Made &lt;here&gt;." in text
    assert "what moves is circled" in text
    assert "what moves is circled" not in paper_page(results, tmp_path / "plain", {}, {}, [], circles=False).read_text(
        encoding="utf-8"
    )
    assert "Dynamic occupancy grid map" not in text  # no such figure was given
    assert "published: Itkina et al. 2019" in text
    for result in results:
        assert f"runs/{result.parent.name}" in text
    assert text.count("<img") == 2 + 2
    assert (page.parent / "conclusions.tex").is_file()
