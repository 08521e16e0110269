"""The page of the paper's results."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from envpred.datamodules.variants import VARIANTS
from envpred.models import FCNForecaster, LastFrame, MovedLastFrame, ParticleForecast, PredNetForecaster
from envpred.report.paper import AGAINST_FCN, AGAINST_PARTICLE, CLAIMS, conclusions_table, contrasts, paper_page
from envpred.report.run import Run
from envpred.report.runs import read_runs
from envpred.report.statistics import Comparison
from envpred.report.tables import comparisons
from tests.report.conftest import draw_windows

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


def test_two_drives_leave_all_open(results: list[Path], make_run: MakeRun) -> None:
    def two(record: dict[str, Any]) -> None:
        record["data"]["windows"] = [[f"drive_{n % 2}", 20 * n] for n in range(len(record["data"]["windows"]))]

    runs = read_runs([make_run(change=two), make_run(FCNForecaster, "prob_dogma", level=0.02, change=two)])
    table = conclusions_table(runs, compared(runs))
    assert {cell.text.rsplit(" ", 1)[1] for row in table.rows for cell in row[2:]} == {"open"}
    assert "with fewer than 6 drives (here 2) no test" in table.caption


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
