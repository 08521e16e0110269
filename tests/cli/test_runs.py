"""Where runs lie: fits apart from tests, under a name of the user's, and never over another run."""

from pathlib import Path

import pytest
import yaml

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
