"""What TensorBoard shows of a run besides pictures: the baselines' lines in its charts, and its row in HPARAMS."""

import math
from pathlib import Path
from typing import Any

import pytest
from lightning.pytorch import Callback, Trainer
from lightning.pytorch.loggers import TensorBoardLogger
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.hparams.plugin_data_pb2 import HParamsPluginData

from envpred.callbacks import Baselines, Hyperparameters, Validations
from envpred.callbacks.baselines import LINES
from envpred.callbacks.hyperparameters import FINAL
from envpred.datamodules import Forecast, Seen
from envpred.models import FCNForecaster, Forecaster, LastFrame, MovedLastFrame
from envpred.models.baselines import _Moved
from envpred.results.validations import read_validations
from tests.models.trainers import grids, trainer
from tests.remedies import refusal
from tests.store.stores import write_store

EPOCHS = 3


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_store(tmp_path_factory.mktemp("charts") / "grids", {name: list(range(40)) for name in "abc"}, cells=32)


def fcn() -> FCNForecaster:
    return FCNForecaster(given=3, horizons=5, width=1 / 32, max_epochs=EPOCHS, lr=1e-2)


def charted(folder: Path, *more: Callback) -> Trainer:
    logger = TensorBoardLogger(str(folder), name="", version="", default_hp_metric=False)
    return trainer(folder, logger=logger, callbacks=[Validations(), Baselines(), Hyperparameters(), *more])


def scalars(folder: Path, tag: str) -> list[tuple[int, float]]:
    """Step and value of what was logged."""
    return [(event.step, event.value) for event in EventAccumulator(str(folder)).Reload().Scalars(tag)]


def error(forecaster: Forecaster, store: Path, folder: Path) -> dict[str, float]:
    """Its own validation."""
    (found,) = trainer(folder).validate(forecaster, grids(store), verbose=False)
    return dict(found)


def row(folder: Path) -> tuple[dict[str, HParamsPluginData], list[str]]:
    """What HPARAMS is told of a run, and the names of its metrics."""
    metadata = EventAccumulator(str(folder)).Reload().summary_metadata
    told = {
        tag.rsplit("/", 1)[1]: HParamsPluginData.FromString(found.plugin_data.content)
        for tag, found in metadata.items()
        if tag.startswith("_hparams_/")
    }
    return told, [info.name.tag for info in told["experiment"].experiment.metric_infos]


def test_a_fit_shows_both_baselines_in_its_charts_and_one_row(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = tmp_path / "run"
    asked: list[int] = []
    forecast = _Moved.forecast

    def counted(self: _Moved, seen: Seen, horizons: int) -> Forecast:
        asked.append(len(seen["occupancy"]))
        return forecast(self, seen, horizons)

    monkeypatch.setattr(_Moved, "forecast", counted)
    charted(run).fit(fcn(), grids(store))
    assert sum(asked) == len(range(0, 40 - 8 + 1, 8))  # once for each validation window, in all epochs together
    baselines = {"static": LastFrame(given=3), "moved": MovedLastFrame(given=3)}
    for name, forecaster in baselines.items():
        expected = error(forecaster, store, tmp_path / name)
        for tag in ("val/mse", "val/mse_0.1s", "val/mse_0.5s"):
            drawn = scalars(run / LINES[name], tag)
            assert [step for step, _ in drawn] == [step for step, _ in scalars(run, tag)]
            assert [value for _, value in drawn] == pytest.approx([expected[tag]] * EPOCHS)
    told, metrics = row(run)
    assert metrics == [FINAL]
    assert {"session_start_info", "session_end_info"} <= told.keys()
    best = read_validations(run).chosen()
    assert best is not None
    assert [value for _, value in scalars(run, FINAL)] == [pytest.approx(best.validation["val_mse"])]
    assert told["session_start_info"].session_start_info.hparams["data.samples"].number_value == 4
    for folder in (run, *(run / name for name in LINES.values())):
        events = EventAccumulator(str(folder)).Reload()
        assert all(math.isfinite(event.value) for tag in events.Tags()["scalars"] for event in events.Scalars(tag))


def test_a_run_that_fails_has_a_row_without_a_value(store: Path, tmp_path: Path) -> None:
    class Fails(Callback):
        def on_train_epoch_end(self, trainer: Trainer, pl_module: Any) -> None:
            raise RuntimeError("out of memory")

    with pytest.raises(RuntimeError, match="out of memory"):
        charted(tmp_path, Fails()).fit(fcn(), grids(store))
    told, metrics = row(tmp_path)
    assert metrics == [FINAL]
    assert "session_end_info" not in told
    tags = EventAccumulator(str(tmp_path)).Reload().Tags()["scalars"]
    assert "val/mse" in tags
    assert FINAL not in tags


def test_without_training_windows_the_moved_last_frame_is_left_out(tmp_path: Path) -> None:
    """Nothing tells then what enters; the forecaster is validated all the same."""
    short = write_store(tmp_path / "grids", {"a": list(range(4)), "b": list(range(40)), "c": list(range(40))})
    run = charted(tmp_path / "run")
    (found,) = run.validate(LastFrame(given=3), grids(short, train=["a"], val=["b"], test=["c"]), verbose=False)
    assert found["val/mse"] == pytest.approx(found["static/mse"])
    assert "moved/mse" not in found


@pytest.mark.parametrize("name", ["windows", "every_n_epochs"])
def test_fewer_pictures_than_none_are_refused(name: str) -> None:
    line = refusal(["fit", "--model=LastFrame", "--data.store=grids", f"--pictures.{name}=-1"])
    assert line == f"--pictures.{name} -1: give 0 for no pictures, or more"
