"""The tables of how sure forecasts are."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from envpred.metrics.best_of_k import BestOfK
from envpred.metrics.brier import Brier
from envpred.metrics.cells import KINDS
from envpred.metrics.ratios import Ratio
from envpred.metrics.spread_skill import SpreadSkill
from envpred.models import FCNForecaster
from envpred.report.details import metric_tables
from envpred.report.how_sure import cells_table, how_sure_table
from envpred.report.runs import read_runs
from tests.report.conftest import HORIZONS, measured, per_window

MakeRun = Callable[..., Path]


def sampled(record: dict[str, Any]) -> None:
    """Samples whose best errs half as much as their mean, and that are too sure of moving cells."""
    values, line = per_window(0.04, 0), torch.linspace(1.0, 0.9, HORIZONS).double()
    about = SpreadSkill(HORIZONS).about
    record["metrics"] |= {
        "mse_best_of_k": measured(values / 2, BestOfK),
        "spread_skill": Ratio(line, line / 10, about).as_json(),
        "spread_skill_moving_cells": Ratio(line / 2, line / 20, about).as_json(),
        "brier": measured(values, Brier),
        "brier_moving_cells": measured(3 * values, Brier),
    }


def undefined(record: dict[str, Any]) -> None:
    """As a forecaster without samples writes it."""
    nothing = torch.full((HORIZONS,), torch.nan)
    record["metrics"] |= {
        "mse_best_of_k": record["metrics"]["mse"],
        "spread_skill": Ratio(nothing, nothing, SpreadSkill(HORIZONS).about).as_json(),
    }


@pytest.fixture
def folders(make_run: MakeRun) -> list[Path]:
    """A run with samples, one without, and one of before there were any."""
    kinds = [{"change": sampled, "level": 0.04}, {"kind": FCNForecaster, "variant": "prob_dogma", "change": undefined}]
    return [*(make_run(**kind) for kind in kinds), make_run(variant="dst_dogma")]


def test_spread_and_best_beside_the_mean(folders: list[Path]) -> None:
    table = how_sure_table(read_runs(folders))
    assert table is not None
    plain = [[cell.plain() for cell in row] for row in table.rows]
    assert plain[0] == [
        "PredNet, DST static",
        *("1.00 ± 0.10", "0.97 ± 0.10", "0.94 ± 0.09", "0.90 ± 0.09"),
        *["0.50 ± 0.00 (0.00)"] * 4,
    ]
    assert plain[1] == ["FCN, probability DOGMa", *["–"] * 4, *["1.00 ± 0.00 (0.00)"] * 4]
    assert plain[2] == ["PredNet, DST DOGMa", *["–"] * 8]
    assert table.columns[-1] == "best of 16 / mean, 1.5 s"


def test_kinds_of_cells(folders: list[Path]) -> None:
    runs = read_runs(folders)
    table = cells_table(runs)
    assert table is not None
    by_cells = {(row[0].text, row[1].text): [cell.plain() for cell in row[2:]] for row in table.rows}
    assert {cells for cells, _ in by_cells} == {"all", *KINDS}
    assert len(by_cells) == 3 * (1 + len(KINDS))
    mean = 1e3 * runs[0].mse.mean[14]
    assert by_cells["all", "PredNet, DST static"][:3] == [f"{mean:.1f}", f"{mean / 2:.1f}", "0.90"]
    assert by_cells["moving", "PredNet, DST static"] == ["–", "–", "0.45", "–", f"{3e-3 * mean:.3f}", "–"]
    assert by_cells["entering", "FCN, probability DOGMa"] == ["–"] * 6


def test_a_metric_and_its_kinds_of_cells_share_a_table(folders: list[Path]) -> None:
    runs = read_runs(folders)
    tables = {table.name: table for table in metric_tables(runs)}
    assert not [name for name in tables if name.endswith("_moving_cells")]
    assert [row[0].text for row in tables["brier"].rows] == [
        "PredNet, DST static",
        "PredNet, DST static, moving cells",
    ]
    assert tables["brier"].rows[1][4].value == pytest.approx(3 * np.mean(per_window(0.04, 0)[:, 14]))
    assert tables["brier"].title == "Brier score ↓"
    assert tables["spread_skill"].title == "Spread over skill (best: 1)"


def test_without_samples_there_is_no_such_table(folders: list[Path]) -> None:
    runs = read_runs(folders[1:])
    assert how_sure_table(runs) is None
    assert cells_table(runs) is None
    assert "spread_skill" not in [table.name for table in metric_tables(runs)]  # all dashes
