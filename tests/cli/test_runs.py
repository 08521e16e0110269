"""Where runs lie: fits apart from tests, under a name of the user's, and never over another run."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from envpred.callbacks import Pictures
from envpred.cli import main
from tests.remedies import remedy
from tests.store.stores import write_store

QUIET = ["--trainer.accelerator=cpu", "--trainer.enable_progress_bar=false", "--trainer.enable_model_summary=false"]


@pytest.fixture(autouse=True)
def inside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_store(tmp_path / "grids", {name: list(range(40)) for name in "abc"})


def test_runs_lie_by_command_under_the_name_given(capsys: pytest.CaptureFixture[str]) -> None:
    still = ["--model", "LastFrame", "--data.store", "grids", *QUIET]
    main(["test", *still, "--name", "first", "--out", "mine"])
    main(["validate", *still, "--out", "mine"])
    runs = Path("mine/test/last_frame/dst_static")
    assert (runs / "first" / "result.json").is_file()
    assert Path("mine/validate/last_frame/dst_static/version_0/config.yaml").is_file()
    before = (runs / "first" / "result.json").read_bytes()
    with pytest.raises(SystemExit):
        main(["test", *still, "--name=first", "--out=mine"])
    line = capsys.readouterr().err
    assert "first: is there already; give another --name" in line
    ((option,),) = remedy(line)
    main(["test", *still, f"{option}=second", "--out=mine"])
    assert (runs / "second" / "result.json").is_file()
    assert (runs / "first" / "result.json").read_bytes() == before
    saved = yaml.safe_load((runs / "first" / "config.yaml").read_text())
    assert (saved["name"], saved["trainer"]["logger"]) == (None, None)
    main(["test", "--config", str(runs / "first" / "config.yaml")])  # in the same place, as a run of its own
    assert (runs / "version_0" / "result.json").is_file()


def test_a_named_fit_is_found_and_resumed() -> None:
    small = ["--model=PredNetForecaster", "--model.channels=[4]", "--model.t1_epochs=1", "--model.t5_epochs=1"]
    fit = ["fit", *small, "--data.store=grids", "--data.samples=2", *QUIET]
    main([*fit, "--name=mine", "--trainer.max_epochs=1"])
    main([*fit, "--name=mine", "--ckpt_path=last"])
    runs = Path("runs/fit/prednet/dst_static")
    assert [folder.name for folder in runs.iterdir()] == ["mine"]
    main(["test", "--config", str(runs / "mine" / "config.yaml"), "--ckpt_path=best"])
    (result,) = Path("runs/test").rglob("result.json")
    assert "mine/checkpoints/best.ckpt" in result.read_text()
    main([*fit, "--name=other", "--trainer.max_epochs=1"])
    before = {file: file.read_bytes() for file in (runs / "mine").rglob("*") if file.is_file()}
    with pytest.raises(SystemExit):
        main([*fit, "--name=mine", "--ckpt_path", str(runs / "other" / "checkpoints" / "last.ckpt")])
    assert {file: file.read_bytes() for file in (runs / "mine").rglob("*") if file.is_file()} == before


@pytest.mark.slow
def test_a_newer_run_without_a_checkpoint_is_told(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It was killed before its first, so that an older one is taken, which may be at its end."""
    monkeypatch.setattr(Pictures, "on_validation_end", lambda *_: None)  # drawing takes longer than all else
    small = ["--model=PredNetForecaster", "--model.channels=[4]", "--model.t1_epochs=1", "--model.t5_epochs=0"]
    fit = ["fit", *small, "--data.store=grids", "--data.samples=2", *QUIET]
    main(fit)
    code = "import os, signal, sys; from envpred.cli import main; from envpred.models import PredNetForecaster\n"
    code += "PredNetForecaster.training_step = lambda *_: os.kill(os.getpid(), signal.SIGKILL)\nmain(sys.argv[1:])"
    assert subprocess.run([sys.executable, "-c", code, *fit], check=False).returncode == -signal.SIGKILL
    main([*fit, "--ckpt_path=last"])
    said = next(line for line in capsys.readouterr().err.splitlines() if line.startswith("checkpoint: "))
    assert said.startswith("checkpoint: runs/fit/prednet/dst_static/version_0/checkpoints/last.ckpt")
    assert "its run has reached its end; newer, but ended before their first checkpoint: version_1;" in said
