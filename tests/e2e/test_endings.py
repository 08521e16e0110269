"""What fit, validate and test say at their end, and that they do not warn of what is done on purpose."""

import json
import shlex
import warnings
from pathlib import Path

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from envpred.cli import main
from envpred.results.result import RESULT
from tests.store.stores import write_store

QUICK = ["--trainer.accelerator=cpu", "--trainer.enable_progress_bar=false", "--trainer.enable_model_summary=false"]
SMALL = ["--model.channels=[4]", "--model.t1_epochs=1", "--model.t5_epochs=1", "--data.samples=2", "--data.crop=16"]


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_store(
        tmp_path_factory.mktemp("endings") / "grids", {name: list(range(40)) for name in "abc"}, cells=32
    )


@pytest.fixture(autouse=True)
def inside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def fit_of(store: Path, *more: str) -> list[str]:
    """A PredNet that trains in a second."""
    return ["--config=prednet_small", "--config=dst_static", "--data.store", str(store), *QUICK, *SMALL, *more]


def next_command(said: str) -> list[str]:
    """The next command that a fit names, as arguments of `main`."""
    (line,) = [line for line in said.splitlines() if line.startswith("next: envpred ")]
    return shlex.split(line)[2:]


def test_a_fit_says_what_to_type_next_and_that_works(
    store: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Also in a folder whose name a shell would split."""
    (tmp_path / "my runs").mkdir()
    monkeypatch.chdir(tmp_path / "my runs")
    args = ["--out", "all runs", "--pictures.windows", "0"]
    main(["fit", *fit_of(store, *args)])
    said = capsys.readouterr().out
    run = Path("all runs/fit/prednet/dst_static/version_0")
    history = json.loads((run / "validations.json").read_text())
    best = history["validations"][history["best"]["best.ckpt"]["validation"]]
    moved = EventAccumulator(str(run)).Reload().Scalars("moved/mse")[0].value
    assert f"run: {run}\n" in said
    errors = (("best.ckpt", best["val_mse"]), ("static baseline", best["static_mse"]), ("moved last frame", moved))
    assert ", ".join(f"{name} {1e3 * error:.1f}" for name, error in errors) in said
    main(next_command(said))
    (result,) = Path("all runs/test").rglob(RESULT)
    assert json.loads(result.read_text())["checkpoint"] == str(run / "checkpoints" / "best.ckpt")
    assert json.loads(result.read_text()).get("pictures") is None
    main(["fit", *fit_of(store, *args), "--model.t1_epochs=0", "--trainer.enable_checkpointing=false"])
    said = capsys.readouterr().out
    assert f"run: {run.with_name('version_1')}\n" in said
    assert "next:" not in said


def test_what_a_run_does_on_purpose_is_no_warning(
    store: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    """From the first fit over one that goes on in its folder to a test elsewhere; tables are ours."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        main(["fit", *fit_of(store, "--trainer.max_epochs=1", "--pictures.every_n_epochs=0")])
        main(["fit", *fit_of(store, "--ckpt_path", "last", "--pictures.every_n_epochs=0")])
        assert not Path("runs/fit/prednet/dst_static/version_1").exists()
        for command in ("validate", "test"):
            capsys.readouterr()
            main([command, *fit_of(store, "--ckpt_path", "best")])
            lines = capsys.readouterr().out.splitlines()
            (head,) = [k for k, line in enumerate(lines) if line.startswith("MSE × 10⁻³ ± standard error over ")]
            assert lines[head + 1].split() == ["0.1", "s", "0.5", "s", "1.0", "s", "1.5", "s"]
            names = [line[: len("moved last frame")].strip() for line in lines[head + 2 :]]
            moved = ["moved last frame"] if command == "validate" else []
            assert names == ["prednet", "static baseline", *moved, "skill"]
        assert not any("test/mse" in line for line in lines)  # Lightning's own table
    ours = [str(warning.message) for warning in found if issubclass(warning.category, UserWarning)]
    assert ours == []
    assert "will override existing callbacks" not in caplog.text
    folder = Path("runs/test/prednet/dst_static/version_0")
    result = json.loads((folder / RESULT).read_text())
    assert result["checkpoint"].endswith("version_0/checkpoints/best.ckpt")
    means = [f"{1e3 * result['metrics']['mse']['mean'][step - 1]:.1f} ±" for step in (1, 5, 10, 15)]
    assert all(mean in lines[head + 2] for mean in means)
    images = set(EventAccumulator(str(folder)).Reload().Tags()["images"])
    assert images == {f"test_window_{k}/{kind}" for k in (0, 1) for kind in ("errors", "animation")}
    events = EventAccumulator("runs/fit/prednet/dst_static/version_0").Reload()
    assert events.Tags()["images"] == []
    assert "train/loss_t1" in events.Tags()["scalars"]  # though an epoch has two batches
