"""The command line as users call it, from drives on the disk to results, on tiny drives."""

import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from envpred.cli import main
from envpred.results.result import RESULT
from tests.store.stores import write_store

REPOSITORY = Path(__file__).resolve().parents[2]
STATIC = REPOSITORY / "configs" / "data" / "dst_static.yaml"
SMALL = REPOSITORY / "configs" / "model" / "prednet_small.yaml"


def _pairs() -> list[Any]:
    """Every model with one variant, and the small PredNet with every variant."""
    models = sorted((REPOSITORY / "configs" / "model").glob("*.yaml"))
    variants = sorted((REPOSITORY / "configs" / "data").glob("*.yaml"))
    pairs = [(model, STATIC) for model in models] + [(SMALL, data) for data in variants if data != STATIC]
    return [
        pytest.param(
            model, variant, marks=pytest.mark.slow if _is_slow(model) else (), id=f"{model.stem}-{variant.stem}"
        )
        for model, variant in pairs
    ]


def _is_slow(model: Path) -> bool:
    """VGG-16 in full writes checkpoints of 1.6 GB; the big and the quick models are others with other numbers."""
    return model.stem in ("fcn", "prednet", "corrected_rollout") or model.stem.startswith("prednet_quick")


PAIRS = _pairs()
QUICK = ["--trainer.accelerator=cpu", "--trainer.enable_progress_bar=false", "--trainer.enable_model_summary=false"]


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    drives = {name: list(range(40)) for name in ("a", "b", "c")}
    folder = tmp_path_factory.mktemp("e2e") / "grids"
    # 32 cells, because FCN halves them five times.
    return write_store(folder, drives, cells=32, dogma=True, context=64, frame="ground")


@pytest.fixture(autouse=True)
def inside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def configured(model: Path, data: Path, store: Path, *more: str) -> list[str]:
    return ["--config", str(model), "--config", str(data), "--data.store", str(store), *QUICK, *more]


def config(name: str) -> Path:
    return REPOSITORY / "configs" / name


def small(store: Path, *more: str) -> list[str]:
    """A PredNet that trains in a second."""
    quick = ["--model.channels=[4]", "--model.t1_epochs=1", "--model.t5_epochs=1", "--data.samples=2", "--data.crop=16"]
    return configured(config("model/prednet_small.yaml"), config("data/dst_static.yaml"), store, *quick, *more)


def failure(args: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """What a command that fails prints; one line, whatever else Lightning has said before."""
    capsys.readouterr()
    with pytest.raises(SystemExit) as stop:
        main(args)
    assert stop.value.code == 1
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("envpred: ")]
    assert len(lines) == 1
    return lines[0]


@pytest.mark.parametrize(("model", "data"), PAIRS)
def test_every_configuration_fits_tests_and_predicts(
    model: Path, data: Path, store: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one_window = ["--data.samples=1", "--data.batch_size=1", "--data.crop=32"]
    one_window += ["--data.val=[b@-20]", "--data.test=[c@-20]"]
    args = configured(model, data, store, *one_window)
    trains = "epochs" in model.read_text(encoding="utf-8")
    if trains:
        main(["fit", *args, "--trainer.max_epochs=1"])
    checkpoint = ["--ckpt_path", "best"] if trains else []
    main(["test", *args, *checkpoint])
    main(["predict", *args, *checkpoint])
    (result,) = Path("runs").rglob(RESULT)
    assert len(list(Path("runs").rglob("predictions/c/*.npy"))) == 1
    newest = [*args, *checkpoint, "--data.predict=newest", "--predictions.folder=newest"]
    if model.stem == "moved_last_frame_oracle":
        assert "true motion" in failure(["predict", *newest], capsys)
    else:
        main(["predict", *newest])
        assert json.loads(Path("newest/manifest.json").read_text(encoding="utf-8"))["windows"][0]["frames"] == list(
            range(15, 20)
        )
    found = json.loads(result.read_text())
    assert len(found["metrics"]["mse"]["mean"]) == 15
    assert found["variant"] == data.stem
    assert trains == (found["checkpoint"] is not None)
    assert (result.parent / "pictures" / "window_0_errors.png").stat().st_size > 1000


def test_tensorboard_shows_what_a_run_did(store: Path) -> None:
    main(["fit", *small(store)])
    run = Path("runs/fit/prednet/dst_static/version_0")
    events = EventAccumulator(str(run)).Reload()
    scalars = set(events.Tags()["scalars"])
    assert {"lr", "stage", "val/mse_0.1s", "val/mse_1.5s", "val/loss_t1", "val/loss_t5", "final/val_mse"} <= scalars
    assert [event.value for event in events.Scalars("stage")] == [0.0, 1.0]
    images = events.Tags()["images"]
    assert {"window_0/forecast", "window_1/forecast", "window_0/comparison", "window_0/animation"} <= set(images)
    assert events.Images("window_0/animation")[-1].encoded_image_string.startswith(b"GIF89a")
    for baseline in ("static_baseline", "moved_last_frame"):
        lines = EventAccumulator(str(run / baseline)).Reload()
        assert {"val/mse", "val/mse_1.5s"} <= set(lines.Tags()["scalars"])
    told = events.summary_metadata["_hparams_/session_start_info"].plugin_data.content
    assert b"t5_lr" in told
    assert b"data.crop" in told


def test_the_users_values_are_not_replaced_by_a_checkpoint(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Lightning's own command line would run with the checkpoint's values here and say nothing."""
    main(["fit", *small(store)])
    checkpoint = "runs/fit/prednet/dst_static/version_0/checkpoints/last.ckpt"
    main(["fit", *small(store, "--model.t5_epochs=2", "--model.t5_lr=0.0025", "--ckpt_path", checkpoint)])
    events = EventAccumulator("runs/fit/prednet/dst_static/version_0").Reload()
    assert events.Scalars("lr")[-1].value == pytest.approx(0.0025)
    line = failure(["test", *small(store, "--model.channels=[8]", "--ckpt_path", checkpoint)], capsys)
    assert "channels [4], the command says [8]" in line
    line = failure(["test", *small(store, "--data.variant=prob_static", "--ckpt_path", checkpoint)], capsys)
    assert "--data.variant dst_static" in line


def test_mistakes_get_one_line(store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "run `envpred fit` first" in failure(["test", *small(store, "--ckpt_path", "best")], capsys)
    assert "nowhere.ckpt: no such checkpoint" in failure(["test", *small(store, "--ckpt_path", "nowhere.ckpt")], capsys)
    assert "no store of grids" in failure(["fit", *small(tmp_path / "nothing")], capsys)
    assert "names drive z" in failure(["fit", *small(store, "--data.train=[z]")], capsys)
    assert "no window of 50 frames" in failure(["fit", *small(store, "--data.length=50")], capsys)
    no_drives = ["grids", "--source", str(tmp_path), "--store", str(tmp_path / "grids")]
    assert "no drive found" in failure(no_drives, capsys)


def test_a_typing_error_names_the_argument(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = failure(["fit", *small(store, "--model.chanels=[4]")], capsys)
    assert line == "envpred: PredNetForecaster has no option chanels; did you mean --model.channels?"


def test_pictures_of_a_store(store: Path, tmp_path: Path) -> None:
    for name in ("frame.png", "drive.gif"):
        main(["show", "--store", str(store), "--out", str(tmp_path / name)])
        assert (tmp_path / name).stat().st_size > 1000


def test_velocities_of_a_store(store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("frame.png", "drive.gif"):
        main(["velocity", "--store", str(store), "--drive", "b", "--out", str(tmp_path / name)])
        assert (tmp_path / name).stat().st_size > 1000
    plain = write_store(tmp_path / "plain", {"a": list(range(4))})
    line = failure(["velocity", "--store", str(plain), "--out", str(tmp_path / "none.png")], capsys)
    assert "--dogma" in line
    line = failure(["velocity", "--store", str(store), "--out", "none.png", "--frame", "40"], capsys)
    assert "40 frames, counted from 0" in line


def test_tensorboard_shows_velocities_of_dogma_variants(store: Path) -> None:
    args = small(store, "--config", str(config("data/dst_dogma.yaml")), "--data.store", str(store))
    main(["fit", *args, "--trainer.max_epochs=1"])
    (run,) = Path("runs").rglob("version_0")
    assert "window_0/velocity" in EventAccumulator(str(run)).Reload().Tags()["images"]


def test_variants_without_velocities_name_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plain = write_store(tmp_path / "plain", {"a": list(range(40)), "b": list(range(40))}, cells=32)
    line = failure(["fit", *small(plain, "--data.variant=dst_dogma")], capsys)
    assert "holds no array 'velocity'" in line
    assert "--dogma" in line
    particles = configured(config("model/particle_forecast.yaml"), config("data/dst_static.yaml"), plain)
    assert "'particle_forecast'" in failure(["test", *particles], capsys)


def test_predictions_without_targets_over_another_horizon(store: Path) -> None:
    """What a user with a newly mapped drive does: fit, forecast its last frames over 2.5 s, look."""
    main(["fit", *small(store)])
    newest = ["--data.predict=newest", "--data.test=[a, c]", "--data.length=30", "--ckpt_path=best"]
    main(["predict", *small(store, *newest)])
    (manifest,) = Path("runs").rglob("manifest.json")  # by default in the run's folder
    found = json.loads(manifest.read_text())
    assert [(w["drive"], w["frames"][-1], w["targets"]) for w in found["windows"]] == [("a", 39, 0), ("c", 39, 0)]
    assert found["horizon_s"][-1] == 2.5
    assert found["checkpoint"].endswith("version_0/checkpoints/best.ckpt")
    assert np.load(manifest.parent / found["windows"][1]["file"]).shape == (25, 32, 32)
    main(["draw", str(manifest.parent.parent), "--window=1", "--store", str(store), "--out=c.png"])
    assert Path("c.png").stat().st_size > 10_000


def test_a_report_of_all_variants_shows_them_on_the_same_windows(store: Path) -> None:
    """Static grids and those with velocities are judged on the same evidence, so one report takes both."""
    for data in ("dst_static", "dst_dogma"):
        main(["test", *configured(config("model/last_frame.yaml"), config(f"data/{data}.yaml"), store)])
    main(["test", *configured(config("model/particle_forecast.yaml"), STATIC, store)])
    main(["report", "runs", "--out", "report"])
    page = Path("report/report.html").read_text(encoding="utf-8")
    assert "c, frame 4: target and forecasts." in page
    assert "kept no forecasts" not in page
    runs = [str(file.parent) for file in sorted(Path("runs").rglob(RESULT))]
    main(["draw", *runs, "--window=1", "--out", "runs.gif"])  # test runs, from the forecasts that they kept
    assert Path("runs.gif").stat().st_size > 10_000
    for label in ("Static, DST static", "Static, DST DOGMa", "Particle filter"):
        assert label in page
    assert {"window_0.png", "window_0.gif", "window_1.png"} <= {file.name for file in Path("report").iterdir()}


def test_verify_finds_a_changed_byte(store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(store, copy)
    main(["verify", "--store", str(copy)])
    with (copy / "b" / "label.npy").open("r+b") as file:
        file.seek(-1, os.SEEK_END)
        file.write(b"\x07")
    assert "b/label.npy: its content has changed" in failure(["verify", "--store", str(copy)], capsys)


def test_random_weights_are_refused_unless_asked_for(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for command in ("validate", "test", "predict"):
        line = failure([command, *small(store)], capsys)
        assert "the weights of PredNetForecaster must come from a checkpoint" in line
        assert "train it by `envpred fit`" in line
    main(["fit", *small(store)])
    main(["test", *small(store), "--ckpt_path=none"])
    (result,) = Path("runs").rglob(RESULT)
    assert json.loads(result.read_text())["model"]["untrained"]
    line = failure(["test", *small(store)], capsys)
    remedy = line.split("give ")[1].split(" (or")[0]
    assert remedy == "--ckpt_path runs/fit/prednet/dst_static/version_0/checkpoints/best.ckpt"
    main(["test", *small(store), *remedy.split()])
    newest = max(Path("runs").rglob(RESULT), key=lambda file: file.stat().st_mtime)
    assert not json.loads(newest.read_text())["model"]["untrained"]


def test_results_say_what_the_checkpoint_was_trained_with(store: Path) -> None:
    main(["fit", *small(store), "--model.t5_lr=1e-5", "--seed_everything=7"])
    main(["test", *small(store), "--model.t5_lr=0.5", "--ckpt_path=best"])
    (result,) = Path("runs").rglob(RESULT)
    told = json.loads(result.read_text())
    assert told["model"]["hyperparameters"]["t5_lr"] == 1e-5
    assert told["seed"] == 7
    assert told["model"]["trained"]["data"]["drives"] == ["a"]


def test_weights_of_other_grids_are_refused(store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drives = {name: list(range(40)) for name in ("a", "b", "c")}
    slow = write_store(tmp_path / "slow", drives, cells=32, period=0.2)
    fine = write_store(tmp_path / "fine", drives, cells=32)
    for manifest in fine.glob("*/manifest.json"):
        told = json.loads(manifest.read_text())
        told["lattice"]["resolution"] = 0.2
        manifest.write_text(json.dumps(told))
    main(["fit", *small(store)])
    for other, difference in ((slow, "0.1 s, slow has 0.2 s"), (fine, "0.3333333333333333 m, fine has 0.2 m")):
        line = failure(["test", *small(other), "--data.length=15", "--ckpt_path=best"], capsys)
        assert "trained on grids of " + difference.replace("slow", str(slow)).replace("fine", str(fine)) in line
