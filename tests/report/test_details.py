"""Tables of further metrics, of planned comparisons, and of what the runs were."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from torch import Tensor

from envpred.metrics.about import About
from envpred.metrics.overlap import IoU
from envpred.metrics.windows import HorizonMetric
from envpred.models import FCNForecaster, MovedLastFrameOracle
from envpred.report import report
from envpred.report.details import comparisons_table, heading, metric_tables, models_table
from envpred.report.runs import read_runs
from envpred.report.tables import comparisons
from tests.report.conftest import measured

MakeRun = Callable[..., Path]


class Bias(HorizonMetric):
    """A metric of a user's own."""

    title, unit, digits, factor, direction, higher_is_better = "Bias", "%", 2, 100.0, 0.0, None
    rewards = "Rewards errors that cancel."

    def measure(self, forecast: Tensor, target: Tensor, last: Tensor) -> Tensor:
        return (forecast - target).mean((-2, -1))


def test_a_metric_that_the_report_has_never_heard_of_is_shown(make_run: MakeRun, tmp_path: Path) -> None:
    values = np.linspace(0.01, 0.03, 15) + np.zeros((30, 1))
    with_bias = make_run(change=lambda record: record["metrics"].update(bias=measured(values, Bias)))
    page = report([with_bias, make_run(FCNForecaster, "prob_dogma")], tmp_path / "out").read_text(encoding="utf-8")
    assert "<h3>Bias (%) (best: 0)</h3>" in page
    rows = (tmp_path / "out" / "bias.md").read_text(encoding="utf-8").splitlines()
    assert rows[2:] == [
        "PredNet, DST static: 0.1 s 1.00 ± 0.00 (0.00); 0.5 s 1.57 ± 0.00 (0.00); 1.0 s 2.29 ± 0.00 (0.00); "
        "1.5 s 3.00 ± 0.00 (0.00).",
        "",
        "Value ± standard error over drives (in brackets over windows, as if they were independent); 30 windows of 10 "
        "drives. Undefined windows do not count. Rewards errors that cancel.",
    ]


def test_a_metric_need_not_say_what_it_rewards(make_run: MakeRun) -> None:
    def silent(record: dict[str, Any]) -> None:
        del record["metrics"]["iou"]["rewards"]

    iou = next(table for table in metric_tables(read_runs([make_run(change=silent)])) if table.name == "iou")
    assert iou.caption.endswith("Undefined windows do not count.")


@pytest.mark.parametrize(
    ("about", "text"),
    [
        (About("MSE", "× 10⁻³", 1, 1e3, "lower"), "MSE × 10⁻³ ↓"),
        (About("Image similarity", "cells", 2, 1.0, "lower"), "Image similarity (cells) ↓"),
        (About("IoU at 0.5", "", 3, 1.0, "higher"), "IoU at 0.5 ↑"),
        (About("Motion ratio", "", 2, 1.0, 1.0), "Motion ratio (best: 1)"),
    ],
)
def test_headings(about: About, text: str) -> None:
    assert heading(about) == text


def test_other_tables_pairs_and_models(all_runs: list[Path]) -> None:
    runs = read_runs(all_runs)
    skill, iou = metric_tables(runs)
    assert iou.caption.endswith(f"do not count. {IoU.rewards}")
    assert (skill.title, iou.title) == ("Skill against the static baseline ↑", "IoU at 0.5 ↑")
    assert (skill.name, iou.name) == ("skill", "iou")
    assert iou.rows[0][2].value == pytest.approx(runs[0].metrics["iou"].mean[4])
    table = comparisons_table(runs, comparisons(runs))
    found = {(row[0].text, row[1].text, row[2].text) for row in table.rows}
    # Seven methods against static, five against the moved last frame (not itself), two inputs of each kind twice.
    assert len(found) == 7 + 6 + 2 + 2
    assert len(table.rows) == 4 * len(found)
    first = table.rows[0]
    assert [cell.text for cell in first[1:4]] == ["PredNet, DST static", "Static", "0.1 s"]
    low, difference, high = first[5].value, first[4].value, first[6].value
    assert low is not None
    assert high is not None
    assert difference is not None
    assert low < difference < high < 0
    assert first[8].bold
    assert "30 windows of 10 drives" in table.caption
    models = models_table(runs, all_runs[0].parent / "report")
    assert [cell.plain() for cell in models.rows[0]] == [
        "PredNet, DST static",
        "learned",
        "123,456",
        "25.00",
        "4.0",
        "3",
        "0123456789ab",
        f"../{all_runs[0].name}",
        "envpred test --config configs/model/prednet.yaml --data.variant dst_static",
    ]
    assert models.rows[4][3].plain() == "–"


def test_oracles_are_marked_wherever_they_stand(make_run: MakeRun, tmp_path: Path) -> None:
    """By their role: a run may be called what it likes."""

    def renamed(record: dict[str, Any]) -> None:
        record["model"]["name"] = "clairvoyant"

    report([make_run(), make_run(MovedLastFrameOracle, "dst_static", 0.01, change=renamed)], tmp_path / "out")
    for table in ("methods", "ratios", "iou", "skill", "models"):
        text = (tmp_path / "out" / f"{table}.md").read_text(encoding="utf-8")
        assert "| Clairvoyant † |" in text, table
        assert "PredNet, DST static †" not in text
        assert text.count("† An oracle reads the future: it is a bound") == 1
    assert r"$\dagger$" in (tmp_path / "out" / "methods.tex").read_text(encoding="utf-8")
