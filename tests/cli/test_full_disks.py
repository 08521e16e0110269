"""Disks that take no more: one line that names the file or the folder, and what was there before stays as it was."""

import os
import resource
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import torch

from envpred.cli import main
from envpred.models.checkpoints import OwnFiles
from envpred.simulate.run import builtin_recording
from envpred.simulate.traffic import Recording
from tests.cli.environment import REPOSITORY, mounting
from tests.remedies import refusal
from tests.store.stores import write_store
from tests.user_errors import Recorder

QUIET = ["--trainer.accelerator=cpu", "--trainer.enable_progress_bar=false", "--trainer.enable_model_summary=false"]
STILL = ["test", "--model=LastFrame", "--data.store=grids", *QUIET]


@contextmanager
def no_room(size: int = 512) -> Iterator[None]:
    """The system lets no file grow beyond `size` bytes, as under a quota."""
    before, recorder = resource.getrlimit(resource.RLIMIT_FSIZE), Recorder.current
    told: list[tuple[str, str]] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recorder, "tell", lambda *what: told.append(what))  # its file is longer
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
    for what in told:
        recorder.tell(*what)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a store, and a test run of it."""
    root = tmp_path_factory.mktemp("full")
    write_store(root / "grids", {name: list(range(40)) for name in "abc"}, dogma=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(root)
        main(STILL)
    return root


RUN = "runs/test/last_frame/dst_static/version_0"


@pytest.mark.parametrize(
    "args",
    [
        ["show", "--store=grids", "--out=out.png"],
        ["show", "--store=grids", "--out=out.gif"],
        ["velocity", "--store=grids", "--out=out.png"],
        ["draw", RUN, "--out=out.gif"],
    ],
    ids=lambda args: f"{args[0]} {args[-1][-3:]}",
)
def test_pictures(folder: Path, monkeypatch: pytest.MonkeyPatch, args: list[str]) -> None:
    monkeypatch.chdir(folder)
    name = args[-1].removeprefix("--out=")
    Path(name).write_text("as it was", encoding="utf-8")
    with no_room():
        assert refusal(args) == f"{name}: File too large; make room, then run the same command again"
    assert Path(name).read_text(encoding="utf-8") == "as it was"
    main(args)
    assert Path(name).stat().st_size > 512
    assert not any(file.name.startswith(".") for file in folder.iterdir())


@pytest.mark.slow
def test_reports(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    main(["report", RUN, "--out=report"])
    before = {file.name: file.read_bytes() for file in Path("report").iterdir()}
    with no_room():
        assert refusal(["report", RUN, "--out=report"]).startswith("report/")
    assert {file.name: file.read_bytes() for file in Path("report").iterdir()} == before


def test_checkpoints_and_recordings(tmp_path: Path) -> None:
    """What torch writes itself ends in a line of its own libraries, not of the disk."""
    checkpoint, recording = {"state_dict": {"a": torch.zeros(1000)}}, Recording.load(builtin_recording())
    for file, write in (
        (tmp_path / "last.ckpt", lambda file: OwnFiles().save_checkpoint(checkpoint, file)),
        (tmp_path / "traffic.npz", recording.save),
    ):
        write(file)
        before = file.read_bytes()
        with no_room(), pytest.raises(OSError, match="File too large") as failure:
            write(file)
        assert failure.value.filename == str(file)
        assert file.read_bytes() == before
    assert sorted(os.listdir(tmp_path)) == ["last.ckpt", "traffic.npz"]


SMALL = [
    "--config=prednet_small",
    "--config=dst_static",
    "--data.crop=null",
    "--data.samples=2",
    "--data.augment=false",
]
SMALL += ["--model.channels=[4]", "--model.t1_epochs=1", "--model.t5_epochs=1", "--model.t1_drop_epoch=1"]


@pytest.mark.slow
@pytest.mark.parametrize(("free", "commands"), [("0", ["fit", "test", "predict"]), ("110k", ["fit"])])
def test_runs_go_on_when_there_is_room_again(folder: Path, tmp_path: Path, free: str, commands: list[str]) -> None:
    """On a small disk, full from the start or after one checkpoint; also what threads of TensorBoard are refused."""
    options = " ".join(f"'{option}'" for option in [*SMALL, f"--data.store={folder / 'grids'}", *QUIET])
    script = f"mount -t tmpfs -o size=3m tmpfs {tmp_path}; cd {tmp_path}"
    for command in commands:
        more = "--pictures.every_n_epochs=0" if command == "fit" else "--ckpt_path=best"
        run = f'if "$@" {command} {options} {more}; then echo done; else echo refused; fi'
        script += f"; head -c 9m /dev/zero > filler || true; truncate -s -{free} filler; {run}; rm filler; {run}"
    done = subprocess.run(
        [*mounting(script), "sh", sys.executable, "-m", "envpred"],
        env={**os.environ, "PYTHONPATH": str(REPOSITORY)},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert "Traceback" not in done.stderr
    said = [line for line in done.stderr.splitlines() if line.startswith("envpred: ")]
    assert all(line.endswith(": No space left on device; make room, then run the same command again") for line in said)
    for line, command in zip(said, commands, strict=True):
        assert str(tmp_path) in line or line.startswith(f"envpred: runs/{command}/")
    codes = [line for line in done.stdout.splitlines() if line in ("done", "refused")]
    assert codes == ["refused", "done"] * len(commands)
