"""A study in PostgreSQL, started here on loopback by a user without privileges (initdb refuses root)."""

import os
import pwd
import shutil
import socket
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import optuna
import pytest

from sweeps.runs.processes import identity
from sweeps.study.best import BEST
from sweeps.study.retry import MAX_LOSSES, WORKER, Watch
from sweeps.study.storage import open_storage
from tests.sweeps.conftest import tuning
from tests.sweeps.study.test_workers import NAME, check_killed_study

USER = "postgres"  # Debian's package makes it


def _binaries() -> Path | None:
    """Where initdb and postgres lie: Debian keeps them off the path."""
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"), key=lambda file: int(file.parts[4]))
    there = shutil.which("initdb")
    return found[-1].parent if found else Path(there).parent if there else None


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    """The URL of an empty database."""
    pytest.importorskip("psycopg", reason="no driver for PostgreSQL: pip install 'envpred[postgresql]'")
    binaries = _binaries()
    if binaries is None:
        pytest.skip("PostgreSQL is not installed: apt-get install postgresql")
    user: dict[str, Any] = {}
    if os.getuid() == 0:
        try:
            pwd.getpwnam(USER)
        except KeyError:
            pytest.skip(f"PostgreSQL does not run as root, and there is no user {USER}")
        user = {"user": USER, "group": USER, "extra_groups": []}
    with tempfile.TemporaryDirectory() as folder:  # not pytest's, which it keeps from other users
        if user:
            shutil.chown(folder, USER, USER)

        def call(program: str, *args: str) -> None:
            command = [str(binaries / program), "-D", f"{folder}/data", *args]
            subprocess.run(command, check=True, cwd=folder, stdout=subprocess.DEVNULL, **user)

        port = _free_port()
        settings = f"-c listen_addresses=127.0.0.1 -c port={port} -c unix_socket_directories={folder} -c fsync=off"
        call("initdb", "-U", "me", "-A", "trust", "--no-sync", "-E", "UTF8")
        call("pg_ctl", "-w", "-l", f"{folder}/log", "-o", settings, "start")
        try:
            yield f"postgresql+psycopg://me@127.0.0.1:{port}/postgres"
        finally:
            call("pg_ctl", "-w", "-m", "immediate", "stop")


@pytest.mark.slow
def test_a_worker_is_killed_in_mid_trial(url: str, store: Path, space_file: Path, tmp_path: Path) -> None:
    args = tuning(store, space_file, tmp_path, "--trials=12", "--pruner=none", f"--storage={url}")
    check_killed_study(tmp_path / NAME, args, url, "tests.sweeps.stub", STUB_SECONDS="1")
    assert f"# storage: {url}" in (tmp_path / NAME / BEST).read_text()


def test_a_lost_trial_is_queued_once(url: str, tmp_path: Path) -> None:
    study = optuna.create_study(storage=open_storage(tmp_path, url), study_name="lost")
    said: list[str] = []
    for _ in range(MAX_LOSSES):
        trial = study.ask()
        trial.suggest_float("x", 0, 1)
        trial.set_user_attr(WORKER, identity() | {"started": 1})
        watches = [
            Watch(optuna.load_study(study_name="lost", storage=open_storage(tmp_path, url)), 60, said.append)
            for _ in range(2)
        ]
        for watch in watches:
            watch.look()
    assert [t.state.name for t in study.trials] == ["FAIL"] * MAX_LOSSES + ["WAITING"]
    assert len({t.params["x"] for t in study.trials}) == 1
    assert len(said) == MAX_LOSSES
