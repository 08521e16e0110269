"""Checkpoints of other hands and other folders: nothing but checkpoints beside them is read or removed."""

import multiprocessing
import os
import signal
import tempfile
from pathlib import Path
from typing import Any

import pytest
import torch

from envpred.errors import UserError
from envpred.models.checkpoints import read_checkpoint
from tests.models.test_prednet import best
from tests.models.trainers import grids, prednet, trainer


def change(file: Path, path: str) -> None:
    """Let what a checkpoint says of others name `path`, in each way that Lightning reads it."""
    content: dict[str, Any] = torch.load(file, weights_only=True)
    for state in content["callbacks"].values():
        if "best_model_path" in state:
            names = dict.fromkeys(("best_model_path", "kth_best_model_path", "last_model_path"), path)
            state.update(names, best_k_models={path: torch.tensor(1e9)})
    torch.save(content, file)


@pytest.mark.parametrize("scheme", ["local://", "file://", "", "../"])
def test_a_checkpoint_removes_nothing_but_checkpoints_of_its_run(store: Path, tmp_path: Path, scheme: str) -> None:
    kept = tmp_path / "photos"
    kept.mkdir()
    (kept / "one.jpg").touch()
    (tmp_path / "weights.ckpt").touch()
    run = tmp_path / "run"
    trainer(run, max_epochs=2).fit(prednet(), datamodule=grids(store))
    last = run / "checkpoints" / "last.ckpt"
    target = os.path.relpath(kept) if scheme == "../" else kept
    for victim in (target, tmp_path / "weights.ckpt"):
        change(last, f"{scheme if scheme.endswith('//') else ''}{victim}")
        trainer(run, max_epochs=3).fit(prednet(), datamodule=grids(store), ckpt_path=last, weights_only=True)
    assert (kept / "one.jpg").exists()
    assert (tmp_path / "weights.ckpt").exists()
    assert {file.name for file in (run / "checkpoints").iterdir()} == {"best_t1.ckpt", "last.ckpt"}


def test_the_second_stage_starts_from_the_best_beside_the_checkpoint_wherever_it_is_run(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not from the best of the folder where it happens to be resumed, though paths there are the same."""
    for place, rate in (("here", 2e-3), ("there", 1e-3)):
        (tmp_path / place).mkdir()
        monkeypatch.chdir(tmp_path / place)
        trainer(Path("run"), max_epochs=3).fit(prednet(t1_lr=rate), datamodule=grids(store))
    file = tmp_path / "here" / "run" / "checkpoints"
    model = prednet(t5_lr=0.0)
    rest = trainer(tmp_path / "here" / "run")  # another way to write its folder
    rest.fit(model, datamodule=grids(store), ckpt_path=file / "last.ckpt", weights_only=True)
    expected = read_checkpoint(file / "best_t1.ckpt")["state_dict"]
    torch.testing.assert_close(model.state_dict()["network.gates.0.weight"], expected["network.gates.0.weight"])
    assert best(rest, "t1").resolve() == (file / "best_t1.ckpt").resolve()
    assert (file / "best_t1.ckpt").is_file()


def test_a_kill_while_saving_leaves_the_checkpoint_before(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where temporary files lie on another disk, from which nothing moves in one step."""
    monkeypatch.setattr(tempfile, "tempdir", "/dev/shm")
    run = trainer(tmp_path, max_epochs=1)
    run.fit(prednet(), datamodule=grids(store))
    io, last = run.strategy.checkpoint_io, tmp_path / "checkpoints" / "last.ckpt"
    content = read_checkpoint(last) | {"more": torch.zeros(10_000_000)}
    io.save_checkpoint(content, last)

    def save() -> None:
        while True:
            io.save_checkpoint(content, last)

    for tenths in range(12):
        process = multiprocessing.get_context("fork").Process(target=save)
        process.start()
        process.join(0.1 + tenths / 100)
        process.kill()
        process.join()
        assert process.exitcode == -signal.SIGKILL
        assert read_checkpoint(last)["epoch"] == 0
    io.save_checkpoint(content, last)
    assert {file.name for file in last.parent.iterdir()} == {"best_t1.ckpt", "last.ckpt"}


def test_the_advice_names_a_checkpoint_that_loads(tmp_path: Path) -> None:
    torch.save({"state_dict": {}}, tmp_path / "best.ckpt")
    (tmp_path / "last.ckpt").touch()
    (tmp_path / "newest.ckpt").write_bytes((tmp_path / "best.ckpt").read_bytes()[:100])
    for name in ("last.ckpt", "newest.ckpt"):
        with pytest.raises(UserError, match=rf"{name}: damaged.*such as \S+best\.ckpt$"):
            read_checkpoint(tmp_path / name)
    (tmp_path / "best.ckpt").unlink()
    with pytest.raises(UserError, match="train it again"):
        read_checkpoint(tmp_path / "last.ckpt")
