"""Rollouts from the command line to the report: how sure they are, and pictures of what they are made of."""

import io
import json
from pathlib import Path

import numpy as np
import PIL.Image
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from envpred.cli import main
from envpred.results.result import RESULT
from tests.store.stores import write_store

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
QUIET = ["--trainer.accelerator=cpu", "--trainer.enable_progress_bar=false", "--trainer.enable_model_summary=false"]


@pytest.fixture(autouse=True)
def inside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder with a small store."""
    monkeypatch.chdir(tmp_path)
    drives = {name: list(range(40)) for name in "abc"}
    write_store(tmp_path / "grids", drives, cells=32, dogma=True, context=64, frame="ground")


def configured(model: str) -> list[str]:
    files = [f"--config={CONFIGS / 'model' / model}.yaml", f"--config={CONFIGS / 'data' / 'dst_static'}.yaml"]
    return [*files, "--data.store=grids", *QUIET]


def test_tensorboard_shows_what_a_corrected_rollout_is_made_of() -> None:
    """Also beside the results of a test; a rollout without a network lacks the row of its correction."""
    fit = [*configured("corrected_rollout"), "--data.samples=1", "--data.val=[b@-20]", "--data.crop=32"]
    main(["fit", *fit, "--trainer.max_epochs=1"])
    run = Path("runs/fit/corrected_rollout/dst_static/version_0")
    (image,) = EventAccumulator(str(run)).Reload().Images("window_0/rollout")
    picture = PIL.Image.open(io.BytesIO(image.encoded_image_string))
    main(["test", *fit, "--ckpt_path=best"])
    main(["test", *configured("rollout")])
    found = [PIL.Image.open(file) for file in sorted(Path("runs").rglob("window_0_rollout.png"))]
    heights = [shown.height / shown.width for shown in (picture, *found)]
    assert heights[0] == pytest.approx(heights[1], rel=0.02)
    assert heights[2] < 0.9 * heights[1]
    result = json.loads(next(Path("runs/test/rollout").rglob(RESULT)).read_text())
    assert result["pictures"]["window_0_rollout"] == "pictures/window_0_rollout.png"


@pytest.mark.slow
def test_samples_are_judged_and_reported(tmp_path: Path) -> None:
    main(["test", *configured("rollout"), "--model.samples=true"])
    main(["test", *configured("rollout")])
    main(["test", *configured("last_frame")])
    versions = [tmp_path / "runs" / "test" / "rollout" / "dst_static" / f"version_{n}" / RESULT for n in (0, 1)]
    sampled, plain = (json.loads(file.read_text())["metrics"] for file in versions)
    assert set(sampled) == set(plain)
    assert sampled["mse"] == plain["mse"]  # samples are beside the forecast and change nothing of it
    assert min(sampled["spread_skill"]["mean"]) > 0
    assert plain["spread_skill"]["mean"] == [None] * 15
    assert plain["mse_best_of_k"]["per_window"] == plain["mse"]["per_window"]
    assert np.isfinite(np.array(sampled["crps_entering_cells"]["mean"][3:], float)).all()
    main(["report", "runs", "--out", "report"])
    rows = (tmp_path / "report" / "how_sure.md").read_text().splitlines()
    cells = [cell.strip() for row in rows if row.startswith("|") for cell in row.split("|")]
    assert cells.count("–") == 8  # two runs without samples at four horizons
    assert "How sure, by kind of cells" in (tmp_path / "report" / "report.html").read_text()
