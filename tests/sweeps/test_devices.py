"""A GPU that is asked for and not there: sweeps refuse it before any of their work, not in their first run."""

from pathlib import Path
from typing import NoReturn

import pytest
import torch

from sweeps import ablation, paper, tune
from sweeps.runs import processes
from tests.remedies import remedy
from tests.sweeps.conftest import SMALL, tuning


class StartedError(Exception):
    """The work would begin now."""


def start(*_: object, **__: object) -> NoReturn:
    raise StartedError


MODULES = {"tune": tune, "ablate": ablation, "paper": paper}


@pytest.mark.parametrize("command", MODULES)
def test_a_gpu_that_is_not_there(
    command: str,
    store: Path,
    space_file: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(processes, "start", start)
    monkeypatch.setattr(paper, "simulate", start)
    out = tmp_path / "out"
    small = ["--data.crop=null", "--variants=[dst_static]", "--switches=[]"]
    args = {
        "tune": tuning(store, space_file, out),
        "ablate": [f"--store={store}", f"--out={out}", f"--config={SMALL}", *small],
        "paper": [f"--out={out}"],
    }[command]
    with pytest.raises(SystemExit) as stop:
        MODULES[command].main([*args, "--trainer.accelerator=gpu"])
    assert stop.value.code == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"envpred {command}: --trainer.accelerator gpu: torch finds no GPU here")
    assert not out.exists()
    (instead,) = remedy(line)
    with pytest.raises(StartedError):
        MODULES[command].main([*args, "=".join(instead)])
