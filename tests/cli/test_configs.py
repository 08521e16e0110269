"""A configuration that a run saved works with every subcommand."""

import json
from pathlib import Path

import pytest
import yaml

from envpred.cli import main
from envpred.cli.configs import portable
from envpred.cli.registry import LIGHTNING
from envpred.results.result import RESULT
from tests.store.stores import write_store

QUIET = ["--trainer.accelerator=cpu", "--trainer.enable_progress_bar=false", "--trainer.enable_model_summary=false"]


@pytest.mark.slow
def test_every_subcommand_reads_what_every_other_saved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_store(tmp_path / "grids", {name: list(range(40)) for name in "abc"})
    model = ["--model=PredNetForecaster", "--model.channels=[4]", "--model.t1_epochs=1", "--model.t5_epochs=1"]
    main(["fit", *model, "--data.store=grids", "--data.samples=2", *QUIET])
    runs = {command: tmp_path / "runs" / command / "prednet" / "dst_static" / "version_0" for command in LIGHTNING}
    saved = {"fit": runs["fit"] / "config.yaml"}
    for command in ("validate", "test", "predict"):
        main([command, "--config", str(saved["fit"]), "--ckpt_path=best"])
        saved[command] = runs[command] / "config.yaml"
    for made_by, file in saved.items():
        for command in ("fit", "validate", "test", "predict"):
            weights = [] if command == "fit" else ["--ckpt_path=best"]
            main([command, "--config", str(file), "--trainer.fast_dev_run=true", *weights])
        assert yaml.safe_load(file.read_text())["data"]["store"] == "grids", made_by
    assert {path.name for path in tmp_path.iterdir()} == {"grids", "runs"}  # fast_dev_run leaves nothing
    tested = json.loads((runs["test"] / RESULT).read_text())
    assert Path(tested["checkpoint"]).name == "best.ckpt"


def test_training_does_not_go_on_from_a_checkpoint_that_was_tested(tmp_path: Path) -> None:
    file = tmp_path / "test.yaml"
    file.write_text("data: {samples: 3}\nckpt_path: best.ckpt\nweights_only: true\nverbose: true\n")
    kept = {
        command: yaml.safe_load(portable([command, f"--config={file}"])[-1].removeprefix("--config="))
        for command in ("fit", "predict")
    }
    assert kept["fit"] == {"data": {"samples": 3}}
    assert kept["predict"]["ckpt_path"] == "best.ckpt"
    assert portable(["test", f"--config={file}"]) == ["test", f"--config={file}"]
