"""Builds on a Dask cluster, on this machine's loopback interface only."""

import contextlib
import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from envpred.build.grids import build
from envpred.errors import UserError
from envpred.store.parts import LOCK
from tests.build import builds

pytestmark = pytest.mark.slow

distributed = pytest.importorskip("distributed", reason="needs Dask: pip install 'envpred[cluster]'")


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("drives")
    for number in range(1, 5):
        builds.write_long_drive(root, f"{number:04d}", 120)
    return root


@pytest.fixture(scope="module")
def local(source: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    store = tmp_path_factory.mktemp("local") / "grids"
    build(source, store, workers=1)
    return builds.content(store)


@pytest.fixture
def cluster() -> Iterator[Any]:
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None, silence_logs=50
    ) as cluster:
        yield cluster


def writers_of(file: Path) -> list[int]:
    """The processes that have it open."""
    found = []
    for handle in Path("/proc").glob("[0-9]*/fd/*"):
        with contextlib.suppress(OSError):
            if handle.readlink() == file:
                found.append(int(handle.parts[2]))
    return found


def kill_writer_when_busy(store: Path) -> int:
    """Wait for a drive that is half written, then kill the process that writes it."""
    end = time.monotonic() + 60
    while time.monotonic() < end:
        for part in builds.parts(store):
            for pid in writers_of(part / "evidence.npy"):
                os.kill(pid, signal.SIGKILL)
                return pid
        time.sleep(0.002)
    return 0


def test_worker_that_dies_costs_nothing_but_time(
    source: Path, tmp_path: Path, cluster: Any, local: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # a store given relative to here, where the workers are not
    store = Path("grids")
    killed: list[int] = []
    killer = threading.Thread(target=lambda: killed.append(kill_writer_when_busy(tmp_path / "grids")))
    killer.start()
    build(source, store, cluster=cluster.scheduler_address)
    killer.join()
    assert killed[0]
    assert killed[0] != os.getpid()
    assert builds.all_valid(store) == sorted({name.split("/")[0] for name in local} - {"store.json", LOCK})
    assert builds.content(store) == local


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nowhere", "tcp://"])
def test_no_scheduler_is_one_line(source: Path, tmp_path: Path, address: str) -> None:
    with pytest.raises(UserError, match=f"{address}: no Dask scheduler answers there .*`dask scheduler`") as failure:
        build(source, tmp_path / "grids", cluster=address)
    assert "\n" not in str(failure.value)
