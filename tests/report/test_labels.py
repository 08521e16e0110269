"""What the methods of a report are called: by what tells them apart, or as the user says."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from envpred.cli import main
from envpred.errors import UserError
from envpred.models import FCNForecaster, LastFrame, PredNetForecaster
from envpred.report import report
from envpred.report.labels import labelled
from envpred.report.runs import read_runs
from envpred.report.seeds import average_seeds
from tests.remedies import refusal
from tests.report.conftest import draw_windows

MakeRun = Callable[..., Path]


def of(seed: int, **hyperparameters: object) -> Callable[[dict[str, Any]], None]:
    def change(record: dict[str, Any]) -> None:
        record["seed"] = seed
        record["model"]["hyperparameters"] = hyperparameters

    return change


def test_runs_of_one_name_are_told_apart_by_what_differs(make_run: MakeRun) -> None:
    folders = [
        make_run(change=of(0, t5_error="absolute")),
        make_run(change=of(0, t5_error="squared")),
        make_run(LastFrame, "dst_static", level=0.09),
        make_run(LastFrame, "dst_dogma", level=0.09),
        make_run(FCNForecaster, "prob_dogma", change=of(0, a=1, b=1, c=1)),
        make_run(FCNForecaster, "prob_dogma", change=of(1, a=2, b=2, c=2)),  # more than a name should hold
    ]
    assert [run.label for run in read_runs(folders)] == [
        *("PredNet, DST static, t5 error absolute", "PredNet, DST static, t5 error squared"),
        *("Static, DST static", "Static, DST DOGMa"),
        *("FCN, probability DOGMa, seed 0", "FCN, probability DOGMa, seed 1"),
    ]


def test_a_label_goes_for_all_seeds_of_a_method(make_run: MakeRun) -> None:
    folders = [make_run(seed=n, change=of(n)) for n in (1, 2)]
    runs = labelled(read_runs([*folders, make_run(FCNForecaster, "prob_dogma")]), [f"{folders[1]}=Ours, big"])
    assert [run.label for run in runs] == ["Ours, big, seed 1", "Ours, big, seed 2", "FCN, probability DOGMa"]
    assert [run.label for run in average_seeds(runs)] == ["Ours, big", "FCN, probability DOGMa"]


def test_a_label_stands_in_every_table_figure_and_caption(make_run: MakeRun, tmp_path: Path) -> None:
    folders = [make_run(), make_run(PredNetForecaster, "prob_static"), make_run(LastFrame, "dst_static", level=0.09)]
    for folder in folders:
        draw_windows(folder)
    names = ["Ours, a=b", "Theirs", "Last"]
    given = [f"--label={folder}={name}" for folder, name in zip(folders, names, strict=True)]
    main(
        [
            "report",
            *map(str, folders),
            *given[:2],
            "--label",
            given[2].removeprefix("--label="),
            f"--out={tmp_path / 'out'}",
        ]
    )
    text = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    for automatic in ("PredNet, DST static", "PredNet, probability static", ">Static<"):
        assert automatic not in text.replace("published", "")[: text.index("Published numbers")]
    for file in ("methods.md", "ratios.tex", "comparisons.csv", "models.md"):
        written = (tmp_path / "out" / file).read_text(encoding="utf-8")
        assert all(name in written for name in names), file


@pytest.mark.parametrize(
    ("label", "line"),
    [
        ("Ours", "--label Ours: give a run's folder and its name, as in runs/test/mine/version_0=Ours"),
        ("{0}=", "give a run's folder and its name"),
        ("nowhere=Ours", "--label nowhere=Ours: nowhere is none of the runs in this report; name the folder of one"),
        ("{root}=Ours", "{root} holds runs of 2 methods; name the folder of one"),
        ("{0}=FCN, probability DOGMa", "--label: {0} and {1} are both called FCN, probability DOGMa; give each a name"),
    ],
)
def test_a_label_that_fits_no_run_is_one_line(make_run: MakeRun, tmp_path: Path, label: str, line: str) -> None:
    folders = [make_run(), make_run(FCNForecaster, "prob_dogma")]
    words = {"root": folders[0].parent}
    label, line = (text.format(*folders, **words) for text in (label, line))
    said = refusal(["report", *map(str, folders), "--label", label, f"--out={tmp_path / 'out'}"])
    assert line in said
    assert "\n" not in said
    assert not (tmp_path / "out").exists()


def test_one_name_for_two_and_two_names_for_one_are_refused(make_run: MakeRun, tmp_path: Path) -> None:
    folders = [make_run(), make_run(FCNForecaster, "prob_dogma")]
    for labels, line in (
        ([f"{folders[0]}=Ours", f"{folders[1]}=Ours"], "are both called Ours; give each a name of its own"),
        ([f"{folders[0]}=Ours", f"{folders[0]}=Mine"], f"{folders[0]} is called Ours already; give it one name"),
    ):
        with pytest.raises(UserError, match=line):
            report(folders, tmp_path / "out", labels=labels)
    assert not (tmp_path / "out").exists()
