"""How many cores there are, whoever asks, and what is said of a cluster that is not there or goes away."""

import os
import sys
from concurrent.futures import CancelledError
from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest

from envpred.build import executors
from envpred.build.executors import available_cores, connect, on_cluster
from envpred.errors import UserError
from tests.build.builds import count_forever
from tests.remedies import installs, remedy


def test_cores_are_those_that_the_process_may_use(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {3, 5, 7}, raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: 64)
    assert available_cores() == 3
    monkeypatch.delattr(os, "sched_getaffinity")  # as on macOS
    assert available_cores() == 64


def test_dask_that_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UserError, match="--cluster needs Dask") as failure:
        connect("tcp://127.0.0.1:9")
    (command,) = remedy(failure.value)
    assert installs(command) == {"dask", "distributed"}


def test_a_scheduler_that_goes_away_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    client = MagicMock()
    client.submit.return_value.result.side_effect = CancelledError
    monkeypatch.setattr(executors, "connect", lambda _: client)
    monkeypatch.setitem(sys.modules, "distributed", SimpleNamespace(as_completed=iter, KilledWorker=ArithmeticError))
    with pytest.raises(UserError, match="tcp://there: the scheduler went away; finished drives are kept"):
        list(on_cluster(count_forever, [SimpleNamespace(name="a", frames=[0])], "tcp://there"))
