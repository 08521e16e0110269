"""Samples from the command line to the report's tables of how sure forecasts are."""

import json
from pathlib import Path

import numpy as np
import pytest

from envpred.cli import main
from envpred.results.result import RESULT
from tests.store.stores import write_store

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
QUIET = ["--trainer.accelerator=cpu", "--trainer.enable_progress_bar=false", "--trainer.enable_model_summary=false"]


def test_samples_are_judged_and_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    drives = {name: list(range(40)) for name in "abc"}
    write_store(tmp_path / "grids", drives, cells=32, dogma=True, context=64, frame="ground")
    data = ["--config", str(CONFIGS / "data" / "dst_static.yaml"), "--data.store=grids", *QUIET]
    rollout = ["--config", str(CONFIGS / "model" / "rollout.yaml"), *data]
    main(["test", *rollout, "--model.samples=true"])
    main(["test", *rollout])
    main(["test", "--config", str(CONFIGS / "model" / "last_frame.yaml"), *data])
    versions = [tmp_path / "runs" / "rollout" / "dst_static" / f"version_{n}" / RESULT for n in (0, 1)]
    sampled, plain = (json.loads(file.read_text())["metrics"] for file in versions)
    assert set(sampled) == set(plain)
    assert sampled["mse"] == plain["mse"]  # samples are beside the forecast and change nothing of it
    assert min(sampled["spread_skill"]["mean"]) > 0
    assert plain["spread_skill"]["mean"] == [None] * 15
    assert plain["mse_best_of_k"]["per_window"] == plain["mse"]["per_window"]
    assert np.isfinite(np.array(sampled["crps_entering_cells"]["mean"][3:], float)).all()
    main(["report", "runs", "--out", "report"])
    rows = (tmp_path / "report" / "how_sure.md").read_text().splitlines()
    assert sum(row.count("–") for row in rows if row.startswith("|")) == 8  # two runs without samples at four horizons
    assert "How sure, by kind of cells" in (tmp_path / "report" / "report.html").read_text()
