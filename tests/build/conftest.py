"""What several tests of builds share."""

import pytest

from envpred.build import jobs


@pytest.fixture
def no_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Jobs that are called here run in this process; those that `builds.run` starts use worker processes as ever."""
    monkeypatch.setattr(
        jobs, "in_processes", lambda job, drives, _: ((len(d.frames), job(d, lambda: None)) for d in drives)
    )
