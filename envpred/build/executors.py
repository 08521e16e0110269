"""Where the per-drive jobs run: in local processes, or on a Dask cluster."""

import contextlib
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import CancelledError, Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from types import SimpleNamespace
from typing import Any, Protocol, TypeVar

from tqdm import tqdm

from envpred.errors import UserError
from envpred.interrupts import handled, interrupt


def available_cores() -> int:
    """Cores that this process may use, which are fewer than the machine's where it is confined to some."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class Framed(Protocol):
    """What a job is done for: a drive, stored or not."""

    name: str

    @property
    def frames(self) -> list[int]:
        """Its frame numbers."""
        ...


D = TypeVar("D", bound=Framed)
# A drive and what to call after each frame -> the line that says why it failed, or None; it must be picklable.
Job = Callable[[D, Callable[[], None]], str | None]
Outcome = Generator[tuple[int, str | None], None, None]  # frames more, and the line of a drive that failed


def in_processes(job: Job[D], drives: list[D], workers: int | None) -> Outcome:
    """Run `job` for each drive in `workers` local processes, by default one a core.

    Closing the generator, or an exception thrown through it, ends the workers where they stand: a handler that unwound
    their work could itself be lost in a destructor, and the build would wait for ever.  What they had begun is the
    caller's to remove.

    Raises:
        UserError: if a worker is killed from outside.
    """
    count = min(workers or available_cores(), len(drives))
    if count == 0:
        return
    context = multiprocessing.get_context("spawn")  # fork would copy torch's and numba's threads half
    # Frames done, a place a drive: each has one writer, so there is no lock that a killed worker could take along.
    frames = context.RawArray("q", len(drives))
    seen = 0
    waiting: set[Future[str | None]] = set()
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(count, context, initializer=_enter_worker, initargs=(frames,))
    interrupts: list[int] = []  # to look at: an exception that meets a destructor or a callback would be lost
    try:
        with handled(lambda number, _: interrupts.append(number)):
            with _interrupts_blocked():
                waiting = {pool.submit(_in_worker, job, drive, place) for place, drive in enumerate(drives)}
            while waiting:
                finished: set[Future[str | None]] = set()
                try:
                    for future in as_completed(waiting, timeout=0.25):
                        finished.add(future)
                        yield 0, future.result()
                except TimeoutError:
                    pass
                waiting -= finished
                if interrupts:
                    interrupt(interrupts[0])
                now = sum(frames)
                yield now - seen, None
                seen = now
        if interrupts:  # while the last frames were told
            interrupt(interrupts[0])
    except BrokenProcessPool:
        if interrupts:  # by a signal to all processes of a job
            interrupt(interrupts[0])
        raise UserError(
            "a worker process was killed from outside (out of memory?); finished drives are kept: "
            "run the same command again to go on, with fewer --workers if memory is short"
        ) from None
    finally:
        if waiting:  # after Ctrl-C or a failure nothing may go on behind our back
            for process in set(multiprocessing.active_children()) - others:
                process.terminate()
        pool.shutdown(wait=True, cancel_futures=True)


@contextlib.contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Block Ctrl-C while worker processes are started: they inherit the mask, and keep it while they import."""
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


_worker = SimpleNamespace(frames=None)  # what a local worker process shares with its parent


def _enter_worker(frames: Any) -> None:
    """Leave Ctrl-C to the parent, and follow it if it is killed."""
    _worker.frames = frames
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()

    def follow() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


def _in_worker(job: Job[D], drive: D, place: int) -> str | None:
    def count() -> None:
        _worker.frames[place] += 1

    return job(drive, count)


def connect(address: str) -> Any:
    """A client of the Dask scheduler at `address`.

    Raises:
        UserError: if Dask is not installed, or no scheduler answers.
    """
    try:
        import distributed
    except ImportError:
        raise UserError("--cluster needs Dask: pip install 'envpred[cluster]'") from None
    try:
        return distributed.Client(address, timeout="5s")
    except (OSError, ValueError) as error:
        raise UserError(
            f"{address}: no Dask scheduler answers there ({error}); start one with `dask scheduler`"
        ) from None


def on_cluster(job: Job[D], drives: list[D], address: str) -> Outcome:
    """Run `job` for each drive as a task on the Dask cluster at `address`; a dead worker's tasks go to another one.

    Raises:
        UserError: if no scheduler answers, or it goes away.
    """
    client = connect(address)
    import distributed

    with client:
        if not client.scheduler_info()["workers"]:
            tqdm.write(f"{address}: has no workers yet; start some with `dask worker {address}`", file=sys.stderr)
        tasks = {client.submit(job, drive, _ignore, pure=False): drive for drive in drives}
        for future in distributed.as_completed(list(tasks)):
            drive = tasks[future]
            try:
                yield len(drive.frames), future.result()
            except distributed.KilledWorker:
                yield 0, f"{drive.name}: every worker that mapped it was killed (out of memory?)"
            except CancelledError:
                raise UserError(
                    f"{address}: the scheduler went away; finished drives are kept: run the same command again to go on"
                ) from None


def _ignore() -> None:
    """Frames are not counted across machines; a drive's come at once when it is done."""
