"""Where studies are kept: torn lines, full disks, databases that do not answer."""

import json
import subprocess
import sys
from pathlib import Path

import optuna
import pytest
from optuna.trial import TrialState

from envpred.errors import UserError
from sweeps.study.storage import JOURNAL, hidden, open_storage, told
from tests.build.test_grids import mount
from tests.remedies import installs, remedy


def study_in(folder: Path) -> optuna.Study:
    return optuna.create_study(storage=open_storage(folder, None), study_name="s", load_if_exists=True)


def fill(study: optuna.Study, disk: Path) -> None:
    with told(disk):
        for k in range(1000):
            study.set_user_attr("filling", f"{k:0300d}")


def test_a_line_torn_by_a_kill_is_cut_off(tmp_path: Path) -> None:
    study = study_in(tmp_path)
    study.tell(study.ask(), 1.0)
    with (tmp_path / JOURNAL).open("ab") as journal:
        journal.write(b'{"op_code":4,"worker')
    other = study_in(tmp_path)
    assert [trial.value for trial in other.trials] == [1.0]  # a reader does not mind
    other.tell(other.ask(), 2.0)
    assert [trial.value for trial in study.trials] == [1.0, 2.0]
    assert all(json.loads(line) for line in (tmp_path / JOURNAL).read_text().splitlines())


@pytest.mark.parametrize("line", [b"[]\n", b'{"op_code": 99}\n', b"\xff\n", b'{"op_code"\n'])
def test_a_damaged_journal_is_one_line(tmp_path: Path, line: bytes) -> None:
    study = study_in(tmp_path)
    study.tell(study.ask(), 1.0)
    for lines in ([line], [line, *(tmp_path / JOURNAL).read_bytes().splitlines(True)[:1]]):
        with (tmp_path / JOURNAL).open("ab") as journal:
            journal.writelines(lines)
        with pytest.raises(UserError, match=r"journal\.log: damaged, its lines .* \(.+\); .*under another name"):
            study_in(tmp_path)


def test_a_full_disk_is_one_line_and_the_study_goes_on(tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    mount(disk, "-t", "tmpfs", "-o", "size=16k", "tmpfs")
    try:
        study = study_in(disk / "studies")
        with pytest.raises(UserError, match="No space left on device; make room"):
            fill(study, disk)
        subprocess.run(["mount", "-o", "remount,size=10m", str(disk)], check=True)
        study.tell(study.ask(), 1.0)
        assert [trial.state for trial in study_in(disk / "studies").trials] == [TrialState.COMPLETE]
    finally:
        subprocess.run(["umount", str(disk)], check=True)


@pytest.mark.parametrize("url", ["postgresql+psycopg://me:secret@127.0.0.1:1/optuna", "sqlite:////nowhere/at/all.db"])
def test_a_database_that_does_not_answer_is_one_line(tmp_path: Path, url: str) -> None:
    if url.startswith("postgresql"):
        pytest.importorskip("psycopg")
    with pytest.raises(UserError) as error:
        open_storage(tmp_path, url)
    assert "not reachable" in str(error.value)
    assert "\n" not in str(error.value)
    assert "secret" not in str(error.value)


def test_a_missing_driver_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "psycopg", None)
    with pytest.raises(UserError, match="its driver is not installed") as failure:
        open_storage(tmp_path, "postgresql+psycopg://127.0.0.1:1/optuna")
    (command,) = remedy(failure.value)
    assert installs(command) == {"psycopg"}


def test_passwords_are_not_shown() -> None:
    assert hidden("postgresql://me:secret@host/db") == "postgresql://me@host/db"
    assert hidden("sqlite:///x.db") == "sqlite:///x.db"
