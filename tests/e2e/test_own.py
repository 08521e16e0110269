"""What users add in files of their own: the examples, run by the command line from the folder that they lie in."""

import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from envpred.cli import main
from envpred.errors import UserError
from envpred.mapping.geometry import FREE, OCCUPIED
from envpred.models.loading import load_forecaster
from envpred.results.predictions import Predictions
from envpred.results.result import RESULT
from envpred.store import Store
from tests.store.stores import write_store

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
QUIET = ["--trainer.accelerator=cpu", "--trainer.enable_progress_bar=false", "--trainer.enable_model_summary=false"]
FORECASTER = "--model=forecaster.ContextForecaster"


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    drives = {name: list(range(40)) for name in ("a", "b", "c")}
    return write_store(tmp_path_factory.mktemp("own") / "grids", drives, dogma=True, context=32)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The examples in a folder that is not on Python's path."""
    shutil.copytree(EXAMPLES, tmp_path / "mine")
    monkeypatch.chdir(tmp_path / "mine")
    monkeypatch.setattr(sys, "path", [p for p in sys.path if p != ""])
    for name in ("forecaster", "variant", "metric", "reader"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    return tmp_path / "mine"


def test_the_example_of_a_forecaster_is_short() -> None:
    assert len((EXAMPLES / "forecaster.py").read_text().splitlines()) < 60


def test_a_forecaster_of_ones_own_goes_all_the_way(folder: Path, store: Path) -> None:
    data = [f"--data.store={store}", "--data.samples=4", "--data.crop=8", "--data.augment=true", *QUIET]
    main(["fit", FORECASTER, *data, "--trainer.max_epochs=2"])
    best = folder / "runs" / "fit" / "context" / "dst_static" / "version_0" / "checkpoints" / "best.ckpt"
    assert best.is_file()
    for command in ("validate", "test", "predict"):
        main([command, FORECASTER, *data, "--ckpt_path=best"])
    main(["test", "--model=envpred.models.LastFrame", *data])
    (result,) = (folder / "runs" / "test" / "context").rglob(RESULT)
    told = json.loads(result.read_text())
    assert (told["role"], told["model"]["name"]) == ("learned", "context")
    assert told["model"]["flops"] > 0
    assert set(told["data"]["input_hash"]) == {"velocity", "context_label", "context_evidence"}
    (static,) = (folder / "runs" / "test" / "last_frame").rglob(RESULT)
    main(["report", str(result), str(static), "--out", "report"])
    assert "Context, DST static" in (folder / "report" / "methods.md").read_text()
    (manifest,) = (folder / "runs" / "predict").rglob("manifest.json")
    main(["draw", str(manifest.parent), "--store", str(store), "--out", "strip.png"])
    assert (folder / "strip.png").stat().st_size > 1000
    forecast = Predictions(manifest.parent).forecast(0)
    assert forecast.shape == (15, 16, 16)
    assert np.ptp(forecast) > 0
    assert load_forecaster(best).hparams["width"] == 8  # its module is there, as the command line has imported it
    del sys.modules["forecaster"]
    with pytest.raises(UserError, match=r"if you trust 'forecaster', import it before, or give it as trusted="):
        load_forecaster(best)
    assert "forecaster" not in sys.modules
    assert load_forecaster(best, trusted=["forecaster"]).hparams["width"] == 8


def test_a_variant_of_ones_own_is_an_input(folder: Path, store: Path) -> None:
    data = [f"--data.store={store}", "--data.variant=variant.KNOWN", "--data.samples=2", "--data.crop=8", *QUIET]
    model = ["--model=PredNetForecaster", "--model.channels=[4]", "--model.t1_epochs=1", "--model.t5_epochs=1"]
    main(["fit", *model, *data])
    main(["test", *model, *data, "--ckpt_path=best"])
    (result,) = (folder / "runs").rglob(RESULT)
    assert json.loads(result.read_text())["variant"] == "variant.KNOWN"
    best = next((folder / "runs").rglob("best.ckpt"))
    del sys.modules["variant"]
    with pytest.raises(UserError, match=r"names 'variant\.KNOWN', and its code would run"):
        load_forecaster(best)
    assert load_forecaster(best, trusted=["variant"]).view.channels == ("occupied", "free", "known")


def test_a_metric_of_ones_own_is_measured_and_shown(folder: Path, store: Path) -> None:
    main(["test", "--model=LastFrame", f"--data.store={store}", "--results.metrics=[metric.Confidence]", *QUIET])
    (result,) = (folder / "runs").rglob(RESULT)
    measured = json.loads(result.read_text())["metrics"]["confidence"]
    assert 0 < measured["mean"][0] <= 0.5
    main(["report", str(result), "--out", "report"])
    assert "Confidence" in (folder / "report" / "report.html").read_text()
    assert f"{measured['mean'][0]:.3f}" in (folder / "report" / "confidence.md").read_text()


def test_a_reader_of_ones_own_is_mapped(folder: Path) -> None:
    """A wall 6 m ahead of a sensor that stands: its cells are occupied, those before it free."""
    drive = folder / "recordings" / "yard"
    drive.mkdir(parents=True)
    wall = np.array([[6, y, z, 0] for y in np.arange(-3, 3, 0.1) for z in np.arange(-1.7, 1, 0.1)], np.float32)
    road = np.array([[x, y, -1.73, 0] for x in np.arange(1, 6, 0.2) for y in np.arange(-3, 3, 0.2)], np.float32)
    for k in range(4):
        np.save(drive / f"{k}.npy", np.concatenate([wall, road]))
    np.save(drive / "poses.npy", np.tile(np.eye(4), (4, 1, 1)))
    main(["grids", "--reader", "reader.find", "--source", "recordings", "--store", "grids", "--workers", "1"])
    label = Store(folder / "grids").drives["yard"].array("label")[-1]
    assert label[64 + 18, 64] == OCCUPIED
    assert (label[64 + 8 : 64 + 17, 64] == FREE).all()


def test_a_reader_that_is_none_is_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("reader.nothing", "nowhere.find", "reader.__doc__"):
        with pytest.raises(SystemExit):
            main(["grids", "--reader", name, "--source", ".", "--store", "grids"])
        assert f"envpred: --reader {name}: " in capsys.readouterr().err
