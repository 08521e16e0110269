"""The paragraph that says how a report's numbers came about."""

import html
from collections.abc import Callable
from pathlib import Path
from typing import Any

from envpred.models import FCNForecaster, LastFrame, MovedLastFrameOracle, PredNetForecaster
from envpred.report import report
from envpred.report.paragraph import paragraph
from envpred.report.runs import read_runs
from envpred.report.seeds import average_seeds
from envpred.report.tables import comparisons
from tests.report.latex import malformed

MakeRun = Callable[..., Path]


def trained(seed: int, revision: str = "0123456789abcdef") -> Callable[[dict[str, Any]], None]:
    def change(record: dict[str, Any]) -> None:
        record |= {"seed": seed, "revision": revision}
        record["model"]["hyperparameters"] = {"t1_epochs": 3, "t5_epochs": 4}
        record["model"]["trained"] = {"data": {"drives": ["town@0-9", "hill"]}, "seed": seed}

    return change


def said(folders: list[Path]) -> str:
    runs = read_runs(folders)
    return paragraph(runs, comparisons(average_seeds(runs)))


def test_it_tells_data_training_seeds_statistics_and_revision(make_run: MakeRun) -> None:
    text = said(
        [
            *(make_run(seed=n, change=trained(n)) for n in (0, 1)),
            make_run(PredNetForecaster, "prob_static", change=trained(5, "fedcba9876543210-dirty")),
            make_run(FCNForecaster, "prob_dogma"),
            make_run(LastFrame, "dst_static", level=0.09),
            make_run(MovedLastFrameOracle, "dst_static", level=0.01),
        ]
    )
    for part in (
        "the same 30 windows of 10 drives (drive_0, drive_1, drive_2, drive_3, drive_4, drive_5 and 4 more; "
        "split: auto)",
        "windows of 20 frames in order, no overlap: 5 frames are shown and 15 forecast, 0.1 s to 1.5 s ahead",
        "PredNet, DST static (123,456 parameters): trained on 2 drives (town@0-9, hill) for 3 and then 4 "
        "epochs, seeds 0, 1, whose errors are averaged window by window.",
        "PredNet, probability static (123,456 parameters): trained on 2 drives (town@0-9, hill) for 3 and then "
        "4 epochs, seed 5.",
        "Of random or unknown weights: FCN, probability DOGMa.",
        "Without training: Static.",
        "Bounds that read the future, and no forecasts: Last frame, true motion.",
        "4 differences that were planned beforehand were tested at 4 horizons each by turning round the signs",
        "revisions 0123456789ab, fedcba987654 with uncommitted changes.",
    ):
        assert part in text
    assert "None" not in text


def test_few_drives_test_nothing(make_run: MakeRun) -> None:
    def two(record: dict[str, Any]) -> None:
        record["data"]["windows"] = [[f"drive_{n % 2}", 20 * n] for n in range(len(record["data"]["windows"]))]

    text = said([make_run(change=two), make_run(FCNForecaster, "prob_dogma", change=two)])
    assert "With fewer than 6 drives (here 2) no difference was tested." in text
    assert "planned beforehand" not in text


def test_it_stands_on_the_page_and_in_files(make_run: MakeRun, tmp_path: Path) -> None:
    folders = [make_run(change=trained(0)), make_run(LastFrame, "dst_static", level=0.09)]
    page = report(folders, tmp_path / "out")
    text = (page.parent / "methods_paragraph.txt").read_text(encoding="utf-8").strip()
    assert text == said(folders)
    assert html.escape(text) in page.read_text(encoding="utf-8")
    assert malformed((page.parent / "methods_paragraph.tex").read_text(encoding="utf-8")) == []
