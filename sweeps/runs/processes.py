"""Child processes that never outlive their parent, and whether another process still runs."""

import contextlib
import ctypes
import os
import platform
import signal
import subprocess
import time
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import IO, Any
from weakref import WeakSet

from envpred.build.executors import available_cores
from envpred.interrupts import heed

PR_SET_PDEATHSIG = 1
SECONDS_TO_END = 10.0
POLL_SECONDS = 0.25
_STARTED: WeakSet[subprocess.Popen[bytes]] = WeakSet()


def start(
    command: Sequence[str], log: IO[bytes], folder: str | None = None, threads: int | None = None
) -> subprocess.Popen[bytes]:
    """Start `command` in a process group of its own and in `folder`, standard output and error into `log`.

    `threads` of torch's are fewer than there are cores where others work beside it.

    Ctrl-C in a terminal thus reaches the parent alone, and the kernel kills the child when its parent dies, also by
    SIGKILL: nobody trains on for a worker that is no more.
    """
    libc, parent = ctypes.CDLL(None), os.getpid()

    def follow() -> None:
        libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:  # it died before the line above
            os._exit(1)

    process = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=log,
        stderr=log,
        process_group=0,
        preexec_fn=follow,  # noqa: PLW1509 - two system calls, nothing that a thread could hold
        cwd=folder,
        env=None if threads is None else os.environ | {"OMP_NUM_THREADS": str(threads)},
    )
    _STARTED.add(process)
    return process


def wait(process: subprocess.Popen[bytes]) -> int:
    """The exit code of a child at its end."""
    while True:
        heed()  # of Ctrl-C while it was started
        with contextlib.suppress(subprocess.TimeoutExpired):
            return process.wait(POLL_SECONDS)


def stop(process: subprocess.Popen[bytes]) -> None:
    """End a child and its own children."""
    for number, patience in ((signal.SIGTERM, SECONDS_TO_END), (signal.SIGKILL, None)):
        if process.poll() is not None:
            return
        try:
            os.killpg(process.pid, number)
            process.wait(patience)
        except (ProcessLookupError, subprocess.TimeoutExpired):
            continue


def stop_all() -> None:
    """End all children that still run, at once: each may take its time."""
    running = [process for process in _STARTED if process.poll() is None]
    if running:
        with ThreadPoolExecutor(len(running)) as pool:
            list(pool.map(stop, running))


def abandon(pool: ThreadPoolExecutor, futures: Sequence[Future[Any]]) -> None:
    """End the children that a pool's threads wait for, and start no more."""
    pool.shutdown(wait=False, cancel_futures=True)
    while not all(future.done() for future in futures):  # one more may have begun before it was cancelled
        stop_all()
        time.sleep(0.1)


def threads_each(workers: int) -> int:
    """Each worker's share of the cores."""
    return max(1, available_cores() // workers)


def identity() -> dict[str, Any]:
    """What tells this process from every other one, on this machine and on others, as plain data."""
    return {"host": platform.node(), "pid": os.getpid(), "machine": _machine(), "started": _started(os.getpid())}


def is_gone(process: dict[str, Any]) -> bool:
    """Whether the process of that `identity` has surely ended; of another machine's processes nothing is sure."""
    return bool(process["machine"] == _machine() and _started(process["pid"]) != process["started"])


def _machine() -> str:
    """This machine since it was started, and the part of it whose process numbers we see."""
    boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="utf-8").strip()
    return f"{boot} {os.readlink('/proc/self/ns/pid')}"


def _started(pid: int) -> int | None:
    """When the process started, in the kernel's ticks; None if there is none or it only waits for its parent."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rsplit(")", 1)[1].split()
    except (FileNotFoundError, ProcessLookupError):
        return None
    return None if fields[0] == "Z" else int(fields[19])
