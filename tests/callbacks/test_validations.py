"""`validations.json`: what each validation of a training found, whatever becomes of the training."""

import csv
import signal
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
import torch
from lightning.pytorch import Trainer
from lightning.pytorch.callbacks import ModelCheckpoint

from envpred.callbacks.validations import Validations
from envpred.cli import main
from envpred.errors import UserError
from envpred.gate.runs import Validation, ValidationErrors
from envpred.models import FCNForecaster
from envpred.results.validations import VALIDATIONS, History, read_validations
from tests.build import builds
from tests.models.trainers import grids, prednet, trainer
from tests.store.stores import write_store

REPOSITORY = Path(__file__).resolve().parents[2]
SMALL = REPOSITORY / "configs" / "model" / "prednet_small.yaml"
BATCHES = 2


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    drives = {name: list(range(40)) for name in "abc"}
    return write_store(tmp_path_factory.mktemp("validations") / "grids", drives, cells=32)


def command(store: Path, folder: Path, *more: str) -> list[str]:
    """`envpred fit` of a PredNet that validates every other moment, logging to CSV in `folder`."""
    model = ["--model.channels=[4]", "--model.t1_lr=0.002", "--model.t5_lr=0.002", "--model.t1_epochs=2"]
    data = [f"--data.store={store}", f"--data.samples={BATCHES}", "--data.batch_size=1", "--data.crop=16"]
    logger = {"save_dir": folder.parent, "name": folder.name, "version": ""}
    options = [f"--trainer.logger.{name}={value}" for name, value in logger.items()]
    quiet = ["--trainer.enable_progress_bar=false", "--trainer.enable_model_summary=false"]
    return ["fit", f"--config={SMALL}", *model, *data, "--trainer.logger=CSVLogger", *options, *quiet, *more]


def logged(folder: Path, name: str) -> dict[int, float]:
    """Epoch -> value of what a run logged to CSV."""
    with (folder / "metrics.csv").open() as lines:
        return {int(row["epoch"]): float(row[name]) for row in csv.DictReader(lines) if row.get(name)}


def checkpoint(folder: Path, name: str) -> dict[str, Any]:
    return dict(torch.load(folder / "checkpoints" / name, weights_only=True))


def test_the_command_writes_what_its_validations_found(store: Path, tmp_path: Path) -> None:
    """Whatever logs beside it; the sanity check before training counts for nothing."""
    run = tmp_path / "run"
    main(command(store, run, "--model.t5_epochs=3"))
    history = read_validations(run)
    assert [(found["epoch"], found["step"], found["stage"]) for found in history.validations] == [
        (epoch, BATCHES * (epoch + 1), "t1" if epoch < 2 else "t5") for epoch in range(5)
    ]
    errors, static = logged(run, "val/mse"), logged(run, "static/mse")
    for found in history.validations:
        assert found["val_mse"] == pytest.approx(errors[found["epoch"]])
        assert found["static_mse"] == pytest.approx(static[found["epoch"]])
        assert list(found["horizons"]) == ["0.1s", "0.5s", "1.0s", "1.5s"]
        assert found["horizons"]["0.5s"]["val_mse"] == pytest.approx(logged(run, "val/mse_0.5s")[found["epoch"]])
        assert found["horizons"]["0.5s"]["static_mse"] == pytest.approx(logged(run, "static/mse_0.5s")[0])
    assert history.best.keys() == {"best_t1.ckpt", "best.ckpt"}
    for name, best in history.best.items():
        losses = logged(run, best["monitor"])
        assert best["validation"] == min(losses, key=losses.__getitem__) == checkpoint(run, name)["epoch"]
        assert best["score"] == pytest.approx(min(losses.values()))
    chosen = history.chosen()
    assert chosen is not None
    assert chosen == ("best.ckpt", history.validations[history.best["best.ckpt"]["validation"]])


def test_a_model_without_stages_is_judged_by_its_error(store: Path, tmp_path: Path) -> None:
    fit = trainer(tmp_path, callbacks=[Validations()], max_epochs=4)
    fit.fit(FCNForecaster(given=3, horizons=5, width=1 / 32, max_epochs=4, lr=1e-3), grids(store))
    history = read_validations(tmp_path)
    errors = [found["val_mse"] for found in history.validations]
    assert [found["stage"] for found in history.validations] == [None] * 4
    assert history.best["best.ckpt"]["validation"] == errors.index(min(errors))
    assert history.best["best.ckpt"]["monitor"] == "val/mse"
    assert history.chosen() == ("best.ckpt", history.validations[errors.index(min(errors))])


def test_several_validations_of_an_epoch_are_told_apart(store: Path, tmp_path: Path) -> None:
    """Also for a user's own checkpoint, of another measure, which the larger the better."""

    class Own(ModelCheckpoint):
        """Of a type of its own: a model's callbacks take the places of a user's of their type."""

    own = Own(monitor="val/skill", mode="max", filename="{step}", save_on_train_epoch_end=False)
    fit = trainer(tmp_path, callbacks=[Validations(), own], val_check_interval=0.5)
    fit.fit(prednet(t1_epochs=0, t5_epochs=3), grids(store))
    history = read_validations(tmp_path)
    assert [(found["epoch"], found["step"]) for found in history.validations] == [
        (epoch, 4 * epoch + step) for epoch in range(3) for step in (2, 4)
    ]
    (mine,) = [name for name in history.best if name != "best.ckpt"]
    assert mine == f"step={history.validations[history.best[mine]['validation']]['step']}.ckpt"
    errors = [found["val_mse"] for found in history.validations]
    assert history.best[mine]["validation"] == errors.index(min(errors))  # the static baseline is the same for all
    assert history.best["best.ckpt"]["validation"] % 2 == 1  # the model's own are written after whole epochs
    chosen = history.chosen()
    assert chosen is not None
    assert chosen.checkpoint == "best.ckpt"


def test_a_resumed_run_goes_on_in_another_folder(store: Path, tmp_path: Path) -> None:
    first, second, third = (tmp_path / name for name in ("first", "second", "third"))
    trainer(first, callbacks=[Validations()], max_epochs=4).fit(prednet(), grids(store))
    last = first / "checkpoints" / "last.ckpt"
    callback = Validations()
    trainer(second, callbacks=[callback]).fit(prednet(), grids(store), ckpt_path=str(last))
    before, after = read_validations(first), read_validations(second)
    assert after.validations[:4] == before.validations
    assert [found["epoch"] for found in after.validations] == list(range(6))
    assert after.best["best_t1.ckpt"] == before.best["best_t1.ckpt"]
    # One callback that trains again, from nothing, begins from nothing.
    trainer(third, callbacks=[callback], max_epochs=1).fit(prednet(), grids(store))
    assert [found["epoch"] for found in read_validations(third).validations] == [0]


def test_only_training_writes(store: Path, tmp_path: Path) -> None:
    trainer(tmp_path, callbacks=[Validations()]).validate(prednet(), grids(store), verbose=False)
    trainer(tmp_path, callbacks=[Validations()], fast_dev_run=True).fit(prednet(), grids(store))
    assert not (tmp_path / VALIDATIONS).exists()
    assert read_validations(tmp_path) == History([], {})
    assert read_validations(tmp_path).chosen() is None


def test_a_new_run_does_not_show_the_validations_of_an_earlier_one(store: Path, tmp_path: Path) -> None:
    """Who looks at a run that has just begun would else take them for its own."""
    seen = []

    class Look(Validations):
        def on_validation_start(self, trainer: Trainer, pl_module: Any) -> None:
            super().on_validation_start(trainer, pl_module)
            seen.append(len(read_validations(tmp_path).validations))

    for _ in range(2):
        trainer(tmp_path, callbacks=[Look()], max_epochs=2, enable_checkpointing=False).fit(prednet(), grids(store))
    assert seen == [0, 1] * 2


def epochs(folder: Path) -> list[int]:
    return [found["epoch"] for found in read_validations(folder).validations]


@pytest.mark.slow
def test_a_killed_run_leaves_its_validations_and_tells_each_once(store: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    args = command(store, run, "--model.t5_epochs=300")
    process = subprocess.Popen(
        [sys.executable, "-m", "envpred", *args],
        cwd=REPOSITORY,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        assert builds.wait_for(lambda: len(epochs(run)) >= 5, process)  # polls, and no look may fail
    finally:
        process.kill()
        said, _ = process.communicate()
    assert process.returncode == -signal.SIGKILL, said
    killed = read_validations(run).validations
    assert [found["epoch"] for found in killed] == list(range(len(killed)))
    for name in (
        "last.ckpt",
        "best_t1.ckpt",
    ):  # the second is of the first or second epoch: the others are trained anew
        kept = int(checkpoint(run, name)["epoch"]) + 1
        assert kept <= len(killed)
        main([*args, f"--ckpt_path={run / 'checkpoints' / name}", f"--trainer.max_epochs={kept + 2}"])
        resumed = read_validations(run)
        assert [found["epoch"] for found in resumed.validations] == list(range(kept + 2))
        assert resumed.validations[:kept] == killed[:kept]
        best = resumed.validations[resumed.best["best.ckpt"]["validation"]]
        assert best["epoch"] == checkpoint(run, "best.ckpt")["epoch"]


HORIZONS: dict[str, ValidationErrors] = {"0.5s": {"val_mse": 0.1, "static_mse": 0.2}}


def test_a_reader_never_sees_half_a_file(tmp_path: Path) -> None:
    """A writer and a reader, as fast as they can."""
    found: Validation = {"epoch": 0, "step": 1, "stage": None, "val_mse": 0.1, "static_mse": 0.2, "horizons": {}}
    callback, target = Validations(), SimpleNamespace(log_dir=str(tmp_path), is_global_zero=True, fast_dev_run=False)
    done = threading.Event()

    def write() -> None:
        for epoch in range(150):
            callback.history.validations.append({**found, "epoch": epoch, "horizons": HORIZONS})
            callback._write(cast(Trainer, target))
        done.set()

    writer = threading.Thread(target=write)
    writer.start()
    counts = []
    while not done.is_set():
        counts.append(len(read_validations(tmp_path).validations))
    writer.join()
    assert counts == sorted(counts)
    assert len(set(counts)) > 10
    assert len(read_validations(tmp_path).validations) == 150
    assert [file.name for file in tmp_path.iterdir()] == [VALIDATIONS]


def test_a_folder_that_cannot_be_written_is_one_line(store: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    target = SimpleNamespace(log_dir=str(tmp_path / "file"), is_global_zero=True, fast_dev_run=False)
    with pytest.raises(UserError, match=r"validations\.json: cannot be written"):
        Validations()._write(cast(Trainer, target))
