"""Checkpoints of other hands and other folders: nothing but checkpoints beside them is read or removed."""

import multiprocessing
import os
import signal
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from envpred.callbacks import Validations
from envpred.errors import UserError
from envpred.models import checksums
from envpred.models.checkpoints import OwnFiles, check_grids, read_checkpoint
from envpred.store.files import checksum
from tests.models.test_prednet import best
from tests.models.trainers import LEAST, grids, prednet, trainer


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
    torch.save(LEAST, tmp_path / "best.ckpt")
    (tmp_path / "last.ckpt").touch()
    (tmp_path / "newest.ckpt").write_bytes((tmp_path / "best.ckpt").read_bytes()[:100])
    for name in ("last.ckpt", "newest.ckpt"):
        with pytest.raises(UserError, match=rf"{name}: damaged.*such as \S+best\.ckpt$"):
            read_checkpoint(tmp_path / name)
    (tmp_path / "best.ckpt").unlink()
    with pytest.raises(UserError, match="train it again"):
        read_checkpoint(tmp_path / "last.ckpt")


def flipped(data: bytes, bit: int) -> bytes:
    changed = bytearray(data)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


def test_a_flipped_bit_anywhere_is_one_line(store: Path, tmp_path: Path) -> None:
    """In weights, in what says where they lie, in the checksum itself, and in what fills the gaps between."""
    run = trainer(tmp_path, max_epochs=1)
    run.fit(prednet(), datamodule=grids(store))
    last = tmp_path / "checkpoints" / "last.ckpt"
    whole = last.read_bytes()
    bits = np.random.default_rng(0).integers(8 * len(whole), size=40)
    for bit in (*range(8), *range(8 * (len(whole) - 46), 8 * len(whole))):  # what says what it is
        last.write_bytes(flipped(whole, bit))
        with pytest.raises(ValueError, match=r"last\.ckpt"):
            checksums.check(last)
    for bit in bits.tolist():
        last.write_bytes(flipped(whole, bit))
        with pytest.raises(UserError, match=r"^\S+last\.ckpt: damaged .*; give another one, such as \S+best_t1\.ckpt$"):
            read_checkpoint(last)
    with pytest.raises(UserError, match="damaged"):  # Lightning's own way to it
        run.strategy.checkpoint_io.load_checkpoint(last)
    last.write_bytes(whole[:-30])
    with pytest.raises(UserError, match="damaged"):
        read_checkpoint(last)
    best_ = tmp_path / "checkpoints" / "best_t1.ckpt"
    best_.write_bytes(flipped(best_.read_bytes(), 8 * 5000))
    with pytest.raises(UserError, match="train it again"):  # no advice to take another damaged one
        read_checkpoint(last)
    last.write_bytes(whole)
    assert read_checkpoint(last)["epoch"] == 0


def test_the_wide_grid_counts_where_it_is_read() -> None:
    trained = {"period": 0.1, "resolution": 0.5, "cells": 64, "context": 96}
    here = {**trained, "context": 128}
    with pytest.raises(
        UserError, match="trained on grids of 96 cells of context, mine has 128 cells of context; build"
    ):
        check_grids(trained, here, True, "mine")
    check_grids(trained, here, False, "mine")


def test_a_checkpoint_is_read_for_its_checksum_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    io, file = OwnFiles(), tmp_path / "a.ckpt"
    io.save_checkpoint({**LEAST, "state_dict": {"a": torch.zeros(1000)}}, file)
    read: list[Path] = []

    def noted(file: Path, stop: int) -> int:
        read.append(file)
        return checksum(file, stop=stop)

    monkeypatch.setattr(checksums, "checksum", noted)
    for _ in range(2):
        read_checkpoint(file)
        io.load_checkpoint(file)
    assert read == [file]
    os.utime(file)
    read_checkpoint(file)
    assert read == [file, file]


def test_a_checkpoint_of_another_hand_is_loaded_with_a_note(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    content = {**LEAST, "state_dict": {"a": torch.zeros(10)}}
    torch.save(content, tmp_path / "a.ckpt")
    torch.save(content, tmp_path / "b.ckpt", _use_new_zipfile_serialization=False)
    OwnFiles().save_checkpoint(content, tmp_path / "c.ckpt")
    with caplog.at_level("INFO", logger="lightning.pytorch"):
        for name in "abc":
            read_checkpoint(tmp_path / f"{name}.ckpt")
    assert [line.split("/")[-1] for line in caplog.messages] == [
        f"{name}.ckpt: carries no checksum, so damage to its weights would not be noticed" for name in "ab"
    ]


@pytest.mark.parametrize("missing", LEAST)
def test_what_is_no_checkpoint_of_lightning_is_refused(tmp_path: Path, missing: str) -> None:
    torch.save({key: value for key, value in LEAST.items() if key != missing}, tmp_path / "a.ckpt")
    with pytest.raises(UserError, match=f"a.ckpt: Object missing required field {missing}; give a checkpoint"):
        read_checkpoint(tmp_path / "a.ckpt")


W, V = torch.zeros(4), {"validations": [], "best": 3}
EDITS: dict[str, tuple[str, Callable[[dict[str, Any]], object]]] = {
    "a weight that is missing": ("weights are not those of this .* is None, not", lambda c: c["state_dict"].popitem()),
    "a weight too many": ("weights are not those .*'more' is .4,., not None", lambda c: c["state_dict"].update(more=W)),
    "another shape": ("weights are not those .* is .4,., not", lambda c: c["state_dict"].update({first(c): W})),
    "no weight": ("weights are not those .* is ..,", lambda c: c["state_dict"].update({first(c): 3})),
    "loops of another": (r"how far it was trained \(loops\.fit_loop", lambda c: c["loops"]["fit_loop"].popitem()),
    "no loops": (r"how far it was trained \(loops\)", lambda c: c.update(loops=[])),
    "no best": ("does not tell which of its run was best", lambda c: first_state(c).pop("best_model_path")),
    "no validations": ("validations of the checkpoint: best: Expected", lambda c: c["callbacks"].update(Validations=V)),
}


def first_state(checkpoint: dict[str, Any]) -> dict[str, Any]:
    """The first state of a callback that keeps checkpoints."""
    found: dict[str, Any] = next(s for s in checkpoint["callbacks"].values() if "best_model_path" in s)
    return found


def first(checkpoint: dict[str, Any]) -> str:
    return str(next(iter(checkpoint["state_dict"])))


@pytest.fixture(scope="module")
def last(store: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("edits")
    run = trainer(folder, callbacks=[Validations()])
    run.fit(prednet(t1_epochs=1, t5_epochs=0), datamodule=grids(store))
    return folder / "checkpoints" / "last.ckpt"


@pytest.mark.parametrize("edit", EDITS)
def test_a_checkpoint_that_was_edited_is_refused(store: Path, last: Path, tmp_path: Path, edit: str) -> None:
    content: dict[str, Any] = torch.load(last, weights_only=True)
    says, change_it = EDITS[edit]
    change_it(content)
    torch.save(content, tmp_path / "a.ckpt")
    run = trainer(tmp_path / "run", callbacks=[Validations()])
    with pytest.raises(UserError, match=says) as refusal:
        run.fit(prednet(t1_epochs=2, t5_epochs=0), datamodule=grids(store), ckpt_path=tmp_path / "a.ckpt")
    assert "give" in str(refusal.value)


def test_a_training_that_has_come_further_than_asked_is_not_gone_on_with(store: Path, tmp_path: Path) -> None:
    longer = prednet(t1_epochs=2, t5_epochs=1)
    trainer(tmp_path / "long").fit(longer, datamodule=grids(store))
    last = tmp_path / "long" / "checkpoints" / "last.ckpt"
    with pytest.raises(UserError, match="trained for 3 epochs, the command says 2; give it as many or more"):
        trainer(tmp_path / "short").fit(prednet(t1_epochs=1, t5_epochs=1), datamodule=grids(store), ckpt_path=last)
    trainer(tmp_path / "same").fit(prednet(t1_epochs=2, t5_epochs=1), datamodule=grids(store), ckpt_path=last)
