"""The same command on the workers of a Dask cluster."""

import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import optuna
import pytest

from envpred.errors import UserError
from sweeps.runs.cluster import attempt, on_cluster
from sweeps.study.storage import open_storage
from tests.remedies import remedy
from tests.sweeps import stub
from tests.sweeps.conftest import REPOSITORY, SMALL

distributed = pytest.importorskip("distributed")


def test_a_failed_command_gives_its_last_line(tmp_path: Path) -> None:
    said = "import os, sys; print(os.getcwd()); sys.exit(sys.argv[1])"
    assert attempt([sys.executable, "-c", said, "broken"], str(tmp_path)) == ["broken"]
    assert attempt([sys.executable, "-c", "pass"], str(tmp_path)) == []
    (line,) = attempt([sys.executable, "-c", "pass"], str(tmp_path / "nowhere"))
    assert "does not see" in line


@pytest.fixture
def cluster(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The address of a scheduler with two workers."""
    monkeypatch.chdir(REPOSITORY)
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None) as found:
        yield found.scheduler_address


def test_a_cluster_runs_the_command_and_says_why_it_fails(cluster: str, tmp_path: Path) -> None:
    (tmp_path / "in.json").write_text("{}")
    tool = [sys.executable, "-m", "json.tool"]
    on_cluster(cluster, [*tool, str(tmp_path / "in.json"), str(tmp_path / "out.json")])
    assert (tmp_path / "out.json").read_text().strip() == "{}"
    with pytest.raises(UserError, match="nowhere") as error:
        on_cluster(cluster, [*tool, str(tmp_path / "nowhere.json")])
    assert len(str(error.value).splitlines()) == 2


@pytest.mark.slow
def test_every_worker_of_a_cluster_joins(
    cluster: str, store: Path, space_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STUB_SECONDS", "1")
    options = {
        "variant": "dst_static",
        "store": store,
        "space": space_file,
        "out": tmp_path,
        "trials": 6,
        "force": True,
    }
    on_cluster(cluster, stub.command_line("tune", options, [f"--config={SMALL}", "--data.crop=null"]))
    storage = open_storage(tmp_path / "prednet_dst_static", None)
    trials = optuna.load_study(study_name="prednet_dst_static", storage=storage).trials
    assert [trial.state.name for trial in trials if trial.state.name != "WAITING"] == ["COMPLETE"] * 6
    assert len({trial.user_attrs["worker"]["pid"] for trial in trials if "worker" in trial.user_attrs}) == 2


@pytest.mark.slow
def test_the_commands_that_start_a_cluster(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those that messages name where there is no scheduler, or none of its workers."""
    monkeypatch.chdir(tmp_path)
    address = "tcp://127.0.0.1:8786"  # Dask's own
    help_of = [sys.executable, "-m", "json.tool", "--help"]

    def refused() -> list[str]:
        with pytest.raises(UserError) as failure:
            on_cluster(address, help_of)
        (command,) = remedy(failure.value)
        return command

    started: list[subprocess.Popen[bytes]] = []
    try:
        for said in ("Scheduler at:", "Starting established connection"):
            with Path(said).open("wb") as log:
                program, *words = refused()
                command = [str(Path(sys.executable).with_name(program)), *words]
                started.append(subprocess.Popen(command, stderr=log, stdout=log))
            while said not in Path(said).read_text(encoding="utf-8"):
                assert started[-1].poll() is None, Path(said).read_text(encoding="utf-8")
                time.sleep(0.1)
        on_cluster(address, help_of)
    finally:
        for process in reversed(started):
            process.terminate()
            process.wait()
