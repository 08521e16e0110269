"""`simulate`: many drives at once, each finished or not there at all."""

import errno
import functools
import hashlib
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
from filelock import FileLock, Timeout

from envpred.build.jobs import run_jobs, say
from envpred.errors import UserError, printable
from envpred.gate import read_json
from envpred.gate.stores import Asked
from envpred.simulate import scene as scenes
from envpred.simulate.lidar import HDL64E, SENSORS
from envpred.simulate.presets import SCAN_BYTES, mixed, pace, plan, town, weights_of
from envpred.simulate.traffic import Recording
from envpred.simulate.writer import DATE, drive_name, write_calibration, write_drive
from envpred.store.files import digest, write_json

ASKED = "simulated.json"  # what all drives of a folder are made from
LOCK = ".lock"


@dataclass
class Planned:
    """A drive that is to be simulated."""

    number: int
    name: str
    frames: list[int]


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
    beams: int = 64,
    mix: str = "default",
    swept: bool = False,
) -> None:
    """Writes simulated drives in KITTI raw's layout to `out`/<date>/<date>_drive_<number>_sync.

    A drive depends on `seed`, its number, `frames`, `beams`, the recording and the mix alone, not on `drives` or
    `workers`.  It is written beside its place and moved there when it is whole; the same command makes those that are
    not there yet.

    Args:
        out: folder that is not there yet, is empty, or holds drives that were simulated alike.
        drives: number of drives.
        frames: scans a drive, at 10 Hz.
        seed: egos, times, towns and street furniture follow from it.
        workers: drives at work at once; by default one a core.
        recording: traffic of `record.record`; by default the one that comes with the package.
        beams: of the scanner, one of `SENSORS`.
        mix: towns that drives lie in, see `presets.weights_of`.
        swept: whether the ego moves on while the sensor turns.

    Raises:
        UserError: if a number or the mix makes no sense, `out` holds something else or is being written, the recording
            is unknown or too short, or the disk is full.
    """
    out = Path(out)
    _check(drives, frames, seed, workers, beams)
    source = recording or builtin_recording()
    recorded = Recording.load(source)
    names = [network.name for network in recorded.networks]
    wanted = weights_of(mix, names)
    weights = {k: wanted[k] for k in _able_towns(recorded, list(wanted), frames)}
    made_from = hashlib.sha256(source.read_bytes()).hexdigest()[:16]
    asked = {"frames": frames, "seed": seed, "beams": beams, "recording": made_from, "mix": mixed(wanted, names)}
    asked |= {"swept": True} if swept else {}
    _check_folder(out, asked)
    day = out / DATE
    planned = [Planned(k, drive_name(k), list(range(frames))) for k in range(1, drives + 1)]
    todo = [drive for drive in planned if not (day / drive.name).exists()]
    done = f"simulated {drives} drives of {frames} scans (seed {seed}) in {day}"
    if not todo:
        print(done)
        return
    for line in plan(drives, frames, seed, weights, names, digest({"drives": drives, **asked})):
        say(line)
    _check_disk(out, len(todo) * frames * SCAN_BYTES)
    with _one_line_for_disk_errors(out), _alone(out):
        _check_folder(out, asked)
        if not (out / ASKED).exists():
            write_json(out / ASKED, asked)
        write_calibration(day)
        _clear(day)
        if len(todo) < drives:
            say(f"{len(todo)} drives to simulate, {drives - len(todo)} of {drives} in {out} already")
        job = functools.partial(_attempt, day=day, seed=seed, source=source, weights=weights, beams=beams, swept=swept)
        try:
            run_jobs(job, todo, "simulating", workers, None)
        finally:
            _clear(day)  # what workers had begun when they were ended
    print(done)


def _check_folder(out: Path, asked: dict[str, object]) -> None:
    """Refuse a folder that holds something else than drives that were simulated as they are `asked` for."""
    if not out.exists() or (out.is_dir() and not any(file.name != LOCK for file in out.iterdir())):
        return
    if not (out / ASKED).exists():
        raise UserError(f"{out} holds something already: give a folder that is not there yet, or empty it")
    frozen = {"swept": False}  # which nobody has to say
    told, asked = frozen | read_json(out / ASKED, Asked, "give another folder"), frozen | asked
    if told != asked:
        differs = [
            f"{name} {printable(str(told.get(name)))} there, {value} asked"
            for name, value in asked.items()
            if told.get(name) != value
        ]
        raise UserError(f"{out}: its drives were simulated otherwise ({', '.join(differs)}); give another folder")


@contextmanager
def _alone(out: Path) -> Iterator[None]:
    """Nobody else simulates into `out` meanwhile; the lock goes with the process, however that ends."""
    out.mkdir(parents=True, exist_ok=True)
    lock = FileLock(out / LOCK, timeout=0)
    try:
        lock.acquire()
    except Timeout:
        raise UserError(f"{out}: another process simulates into it; wait for it, or give another folder") from None
    try:
        yield
    finally:
        lock.release()


def _clear(day: Path) -> None:
    """Remove what a killed run had begun; its names are ours."""
    for unfinished in day.glob(f".{DATE}_drive_*_sync.unfinished"):
        shutil.rmtree(unfinished, ignore_errors=True)


def _check(drives: int, frames: int, seed: int, workers: int | None, beams: int) -> None:
    for name, value, least in (("--drives", drives, 1), ("--frames", frames, 2), ("--seed", seed, 0)):
        if value < least:
            raise UserError(f"{name} {value}: give at least {least}")
    if drives > 9999:
        raise UserError(f"--drives {drives}: KITTI's names have four digits, so 9999 at most")
    if beams not in SENSORS:
        raise UserError(f"--beams {beams}: give one of {', '.join(map(str, SENSORS))}")
    if workers is not None and workers < 1:
        raise UserError(f"--workers {workers}: give at least 1, or leave it out for one a core")


def _able_towns(recording: Recording, towns: list[int], frames: int) -> list[int]:
    """Those of the `towns` (numbers) where a car drives for so many frames."""
    longest = {k: recording.networks[k].longest(recording.interval) for k in towns}
    able = [k for k, frames_there in longest.items() if frames_there >= frames]
    if not able:
        raise UserError(
            f"--frames {frames}: no car of the recording drives that long (longest: {max(longest.values())} frames); "
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


def _attempt(
    drive: Planned,
    on_frame: Callable[[], None],
    *,
    day: Path,
    seed: int,
    source: Path,
    weights: dict[int, float],
    beams: int,
    swept: bool,
) -> str | None:
    """Simulate one drive; a failure that the user can mend comes back as its line, so that other drives go on."""
    try:
        _drive(day, drive.number, len(drive.frames), seed, source, weights, on_frame, SENSORS[beams], swept)
    except UserError as error:
        return str(error)
    return None


def _drive(
    day: Path,
    number: int,
    frames: int,
    seed: int,
    source: Path,
    weights: dict[int, float],
    on_frame: Callable[[], None] = lambda: None,
    sensor: HDL64E = SENSORS[64],
    swept: bool = False,
) -> None:
    """Builds, casts and writes one drive."""
    rng = np.random.default_rng([seed, number])
    network = town(seed, number, weights)
    recording = Recording.load(source)
    scene = scenes.build(recording, network, recording.motions(network), frames, pace(seed, number), rng)
    final = day / drive_name(number)
    unfinished = day / f".{final.name}.unfinished"
    with _one_line_for_disk_errors(final):
        shutil.rmtree(unfinished, ignore_errors=True)
        try:
            for _ in write_drive(unfinished, scene, sensor, number, rng, swept):
                on_frame()
            unfinished.rename(final)
        except BaseException:
            shutil.rmtree(unfinished, ignore_errors=True)
            raise
