"""`simulate`: many drives at once, each finished or not there at all."""

import errno
import multiprocessing
import shutil
import sys
import time
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from importlib import resources
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from typing import Any

import numpy as np

from envpred.build.executors import available_cores
from envpred.errors import UserError
from envpred.simulate import scene as scenes
from envpred.simulate.lidar import HDL64E
from envpred.simulate.traffic import Recording
from envpred.simulate.writer import DATE, drive_name, write_calibration, write_drive

_SLOWEST, _FASTEST = 3.0, 12.5  # m/s: mean speeds that egos are looked for at
_GOLDEN = (5**0.5 - 1) / 2
_SCAN_BYTES = 2_600_000  # a scan with its labels on disk

_scans_done: "Synchronized[int] | None" = None


def builtin_recording() -> Path:
    """The recording that comes with the package."""
    return Path(str(resources.files("envpred.simulate") / "traffic.npz"))


def simulate(
    out: Path,
    drives: int = 10,
    frames: int = 150,
    seed: int = 0,
    workers: int | None = None,
    recording: Path | None = None,
) -> None:
    """Writes simulated drives in KITTI raw's layout to `out`/<date>/<date>_drive_<number>_sync.

    A drive depends on `seed`, its number, `frames` and the recording alone, not on `drives` or `workers`.  It is
    written beside its place and moved there when it is whole.

    Args:
        out: folder that is not there yet, or is empty.
        drives: number of drives.
        frames: scans a drive, at 10 Hz.
        seed: egos, times, towns and street furniture follow from it.
        workers: drives at work at once; by default one a core.
        recording: traffic of `record.record`; by default the one that comes with the package.

    Raises:
        UserError: if a number makes no sense, `out` holds something, the recording is unknown or too short, or the
            disk is full.
    """
    out = Path(out)
    processes = _check(out, drives, frames, seed, workers)
    source = recording or builtin_recording()
    towns = _able_towns(Recording.load(source), frames)
    day = out / DATE
    _check_disk(out, drives * frames * _SCAN_BYTES)
    with _one_line_for_disk_errors(out):
        write_calibration(day)
    context = multiprocessing.get_context("spawn")
    counter = context.Value("q", 0)
    with ProcessPoolExecutor(min(processes, drives), context, _start, (counter,)) as pool:
        jobs = {pool.submit(_drive, day, number, frames, seed, source, towns) for number in range(1, drives + 1)}
        try:
            _watch(jobs, counter, drives, frames)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    print(f"simulated {drives} drives of {frames} scans (seed {seed}) in {day}")


def _check(out: Path, drives: int, frames: int, seed: int, workers: int | None) -> int:
    for name, value, least in (("--drives", drives, 1), ("--frames", frames, 2), ("--seed", seed, 0)):
        if value < least:
            raise UserError(f"{name} {value}: give at least {least}")
    if drives > 9999:
        raise UserError(f"--drives {drives}: KITTI's names have four digits, so 9999 at most")
    if workers is not None and workers < 1:
        raise UserError(f"--workers {workers}: give at least 1, or leave it out for one a core")
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise UserError(f"{out} holds something already: give a folder that is not there yet, or empty it")
    return workers or available_cores()


def _able_towns(recording: Recording, frames: int) -> list[int]:
    """Numbers of the towns where a car drives for so many frames."""
    longest = [network.longest(recording.interval) for network in recording.networks]
    able = [k for k, frames_there in enumerate(longest) if frames_there >= frames]
    if not able:
        raise UserError(
            f"--frames {frames}: no car of the recording drives that long (longest: {max(longest, default=0)} frames); "
            "ask for fewer frames, or record more seconds of traffic and give it as --recording"
        )
    return able


def _check_disk(out: Path, needed: int) -> None:
    place = out.absolute()
    while not place.exists():
        place = place.parent
    free = shutil.disk_usage(place).free
    if free < needed:
        raise UserError(
            f"{out}: the drives need about {needed / 1e9:.1f} GB, {free / 1e9:.1f} GB are free; "
            "ask for fewer --drives or --frames, or give another disk"
        )


@contextmanager
def _one_line_for_disk_errors(place: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if error.errno == errno.ENOSPC:
            raise UserError(f"{place}: no space left on the disk; free some or give another folder") from None
        raise UserError(f"{place}: cannot be written ({error.strerror or error}); give another folder") from None


def _start(counter: "Synchronized[int]") -> None:
    global _scans_done  # noqa: PLW0603 - a worker's only way to keep what its initializer gets
    _scans_done = counter


def _drive(day: Path, number: int, frames: int, seed: int, source: Path, towns: list[int]) -> None:
    """Builds, casts and writes one drive."""
    rng = np.random.default_rng([seed, number])
    # Every block of as many drives as there are towns visits each town once, in an order of its own.
    block, turn = divmod(number - 1, len(towns))
    network = int(np.random.default_rng([seed, 0, block]).permutation(towns)[turn])
    recording = Recording.load(source)
    # Multiples of the golden ratio spread evenly, however many drives there are.
    offset = np.random.default_rng([seed, 0]).random()
    pace = _SLOWEST + (_FASTEST - _SLOWEST) * ((offset + number * _GOLDEN) % 1.0)
    scene = scenes.build(recording, network, recording.motions(network), frames, pace, rng)
    final = day / drive_name(number)
    unfinished = day / f".{final.name}.unfinished"
    with _one_line_for_disk_errors(final):
        shutil.rmtree(unfinished, ignore_errors=True)
        try:
            for _ in write_drive(unfinished, scene, HDL64E(), number, rng):
                if _scans_done is not None:
                    with _scans_done.get_lock():
                        _scans_done.value += 1
            unfinished.rename(final)
        except BaseException:
            shutil.rmtree(unfinished, ignore_errors=True)
            raise


def _watch(jobs: set[Future[None]], counter: Any, drives: int, frames: int) -> None:
    """Shows progress until all jobs are done; raises what one of them raised."""
    start, total, finished = time.monotonic(), drives * frames, 0
    while jobs:
        done, jobs = wait(jobs, timeout=1.0, return_when=FIRST_COMPLETED)
        for job in done:
            job.result()
        finished += len(done)
        rate = counter.value / (time.monotonic() - start)
        left = (total - counter.value) / rate if rate else float("nan")
        line = f"drives {finished}/{drives}, scans {counter.value}/{total}, {rate:.1f} scans/s, {left:.0f} s left"
        if sys.stderr.isatty():
            print(f"\r{line}   ", end="" if jobs else "\n", file=sys.stderr, flush=True)
        elif done:
            print(line, file=sys.stderr, flush=True)
