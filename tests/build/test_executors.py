"""How many cores there are: those that the process may use, whoever asks."""

import os
from pathlib import Path

import pytest

from envpred.build.executors import available_cores
from envpred.simulate import run


def test_cores_are_those_that_the_process_may_use(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {3, 5, 7}, raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: 64)
    assert available_cores() == 3
    assert run._check(tmp_path / "new", drives=4, frames=2, seed=0, workers=None) == 3
    monkeypatch.delattr(os, "sched_getaffinity")  # as on macOS
    assert available_cores() == 64
