"""Devices that are not there, and what Lightning's trainer refuses: one line, before anything is read or written."""

from pathlib import Path

import pytest
import torch

from envpred.build import dogma
from envpred.cli import main
from tests.remedies import refusal, remedy
from tests.store.stores import write_store

STILL = ["test", "--model=LastFrame", "--data.store=grids", "--trainer.fast_dev_run=true"]


@pytest.fixture(autouse=True)
def inside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_store(tmp_path / "grids", {name: list(range(40)) for name in "abc"})


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
@pytest.mark.parametrize("name", ["gpu", "cuda"])
def test_a_trainer_without_a_gpu(name: str) -> None:
    said = refusal([*STILL, f"--trainer.accelerator={name}"])
    assert said.startswith(f"--trainer.accelerator {name}: torch finds no GPU here")
    ((option, value),) = remedy(said)
    main([*STILL, f"{option}={value}"])


def test_what_the_trainer_does_not_take(capsys: pytest.CaptureFixture[str]) -> None:
    said = refusal([*STILL, "--trainer.devices=0"])
    assert said.startswith("--trainer: `Trainer(devices='0')` value is not a valid input")
    assert refusal([*STILL, "--trainer.accelerator=moon"]).startswith("--trainer: You selected an invalid accelerator")
    assert refusal([*STILL, "--trainer.max_epochs=-5"]).startswith("--trainer: `max_epochs` must be")
    (command,) = remedy(said)
    with pytest.raises(SystemExit):
        main(command)
    assert "--trainer.devices" in capsys.readouterr().out


def test_velocities_on_a_device_that_is_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """Refused before the drives are mapped, too."""
    asked: list[object] = []
    monkeypatch.setattr(dogma, "run_jobs", lambda *arguments: asked.append(arguments))
    args = ["grids", "--store=grids", "--dogma"]
    said = refusal([*args, "--device=moon"])
    assert refusal(["grids", "--source=nowhere", "--store=new", "--dogma", "--device=moon"]) == said
    assert asked == []
    assert not Path("new").exists()
    ((option, value),) = remedy(said)
    main([*args, f"{option}={value}"])
    assert len(asked) == 1
