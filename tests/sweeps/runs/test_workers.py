"""Processes that work beside each other: what they say, what their failures say, and that none is left behind."""

from pathlib import Path

import pytest

from envpred.errors import UserError
from sweeps.runs import processes
from sweeps.runs.workers import beside


def shell(script: str) -> list[str]:
    return ["sh", "-c", script]


def test_what_workers_say_is_said_once_with_each_its_share_of_the_cores(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(processes, "available_cores", lambda: 7)
    beside(3, "tune", shell("echo worker $$; echo $OMP_NUM_THREADS threads; echo; echo best; echo twice; echo twice"))
    lines = capsys.readouterr().out.splitlines()
    assert len({line for line in lines if line.startswith("worker ")}) == 3
    assert sorted(line for line in lines if not line.startswith("worker ")) == ["", "2 threads", "best", *["twice"] * 2]


@pytest.mark.parametrize(
    ("end", "reason"),
    [
        ("echo 'envpred tune: the disk is full' >&2; exit 1", "the disk is full"),
        ("kill -9 $$", "it was ended by signal 9 (out of memory?)"),
    ],
)
def test_one_fails_and_the_others_go_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, end: str, reason: str) -> None:
    """Whoever makes the folder fails; the other has something to do once that was told."""
    lines = []

    def say(line: str) -> None:
        lines.append(line)
        if "failed" in line:
            (tmp_path / "told").touch()

    monkeypatch.setattr("sweeps.runs.workers.say", say)
    script = f"mkdir first 2>/dev/null && {{ {end}; }}; until [ -e told ]; do sleep 0.02; done; echo done"
    monkeypatch.chdir(tmp_path)
    beside(2, "tune", shell(script))
    assert lines == [f"a worker failed, 1 of 2 still work: {reason}", "done"]


def test_all_fail_for_one_reason(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(UserError, match=r"^trials fail and fail$"):
        beside(3, "tune", shell("echo 'envpred tune: trials fail and fail' >&2; exit 1"))
    with pytest.raises(UserError, match=r"^no such thing$"):
        beside(2, "tune", shell("echo no such thing; exit 1"))
    with pytest.raises(UserError, match=r"^exit code 3$"):
        beside(2, "tune", shell("exit 3"))


def test_an_interruption_ends_them_all(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(futures: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("sweeps.runs.workers.as_completed", interrupted)
    with pytest.raises(KeyboardInterrupt):
        beside(2, "tune", shell("sleep 100"))
    assert not [process for process in processes._STARTED if process.poll() is None]
