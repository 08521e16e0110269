"""The per-drive job: drive -> mapping -> store, in local processes or on a Dask cluster."""

import contextlib
import functools
import platform
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from tqdm import tqdm

from envpred.build.executors import D, Job, in_processes, on_cluster
from envpred.drives import Drive, find_drives
from envpred.errors import UserError
from envpred.interrupts import ends_at_once
from envpred.mapping import evidence
from envpred.mapping.evidence import EvidenceParameters
from envpred.mapping.geometry import PAPER_SENSOR_OFFSET, GridSpec
from envpred.mapping.ground import GroundSegmenter, MarkovRandomField
from envpred.mapping.label_grid import RayCasting
from envpred.store import DriveWriter, Store, sweep


@dataclass(frozen=True)
class MappingParameters:
    """Everything that decides what the grids of a drive look like.

    Args:
        grid: cells and resolution.
        ground: how ground is told from obstacles.
        rays: how obstacles become a label grid.
        evidence: what labels say, and how fast it fades.
        sensor: where the sensor sits: the drive's `calibration`, or the `paper`'s fixed offset without rotation.
    """

    grid: GridSpec = field(default_factory=GridSpec)
    ground: GroundSegmenter = field(default_factory=MarkovRandomField)
    rays: RayCasting = field(default_factory=RayCasting)
    evidence: EvidenceParameters = field(default_factory=EvidenceParameters)
    sensor: Literal["calibration", "paper"] = "calibration"

    def as_dict(self) -> dict[str, Any]:
        """Plain data that says it all, for the store's index and its hash."""
        return {**asdict(self), "ground": {"method": type(self.ground).__name__, **vars(self.ground)}}


def build(
    source: Path,
    store: Path,
    parameters: MappingParameters | None = None,
    drives: list[str] | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    force: bool = False,
) -> None:
    """Map every drive under `source` that the store does not hold yet.

    Raises:
        UserError: if drives fail (after the others are done), or the store does not fit.
    """
    if workers is not None and workers < 1:
        raise UserError(f"--workers {workers} must be at least 1")
    parameters = parameters or MappingParameters()
    with ends_at_once():  # readers bring libraries of their own
        found = _chosen(find_drives(source), drives)
    target = Store(store)
    key = target.claim("mapping", parameters.as_dict(), force=force)
    sweep(store)
    done = {name for name, stored in target.drives.items() if stored.manifest["groups"].get("mapping") == key}
    todo = [drive for drive in found if force or drive.name not in done]
    if not todo:
        _say(f"nothing to do: {store} holds {_drives(len(found))} of {source}")
        return
    _say(f"{_drives(len(todo))} to map, {len(found) - len(todo)} of {len(found)} in {store} already")
    start = time.monotonic()
    ready, failures = _check(todo)
    ready.sort(key=lambda drive: -len(drive.frames))  # the longest first, so that no worker is left with it at the end
    job = functools.partial(_attempt, store=store.resolve(), parameters=parameters, key=key)
    if ready and not cluster:
        with ends_at_once():  # the compiler has C callbacks, in which the exception of a Ctrl-C would be lost
            _compile(parameters)
    try:
        mapped = run_jobs(job, ready, "mapping", workers, cluster, failures)
    finally:
        sweep(store)  # what workers had begun when they were ended
    _say(f"{_drives(len(todo))}, {mapped} frames mapped into {store} in {time.monotonic() - start:.0f} s")


def run_jobs(
    job: Job[D],
    drives: list[D],
    what: str,
    workers: int | None,
    cluster: str | None,
    failures: list[str] | None = None,
) -> int:
    """Run `job` for all drives with a progress bar called `what`; returns the number of frames.

    Raises:
        UserError: with a line for each drive that failed (`failures` are those that had failed before).
    """
    failures = [] if failures is None else failures
    count, before = 0, len(failures)
    with (
        contextlib.closing(on_cluster(job, drives, cluster) if cluster else in_processes(job, drives, workers)) as jobs,
        tqdm(total=sum(len(d.frames) for d in drives), unit="frame", disable=not drives, mininterval=0.5) as bar,
    ):
        bar.set_description("starting workers")
        for frames, failure in jobs:
            if frames:
                if not count:
                    bar.unpause()  # rate and time left are the job's, not the start's
                    bar.set_description(what)
                count += frames
                bar.update(frames)
            if failure:
                failures.append(failure)
    if failures:
        failed = f"{len(failures)} of {before + len(drives)} drives failed; the others are done"
        raise UserError("\n".join([*failures, failed]))
    return count


def map_drive(
    drive: Drive, store: Path, parameters: MappingParameters, key: str, on_frame: Callable[[], None] = lambda: None
) -> int:
    """Map one drive, frame by frame, into the store; returns its number of frames.

    Evidence starts anew after a gap in the frames: what lies between is not known.
    """
    spec, frames, stretches = parameters.grid, drive.frames, drive.stretches()
    poses = drive.poses
    sensor_to_body = PAPER_SENSOR_OFFSET if parameters.sensor == "paper" else drive.sensor_to_body()
    origin = spec.lattice_origin(poses[:, :3, 3])
    centre_cell = spec.cell_of(poses[:, :3, 3], origin)
    starts = {first for first, _ in stretches}
    T, H = len(frames), spec.cells
    about = {
        "drive": drive.name,
        "frames": frames,
        "stretches": stretches,
        "source": {"drive": drive.name, "frames": T},
        "lattice": {"origin": origin.tolist(), "resolution": spec.resolution, "cells": spec.cells, "context": None},
        "period": drive.period,
        "sensor": sensor_to_body.tolist(),
        "body": asdict(drive.body),
    }
    with DriveWriter(store, drive.name, "mapping", key, about) as out:
        labels = out.add("label", np.uint8, (T, H, H))
        masses = out.add("evidence", np.float16, (T, 2, H, H))
        times = drive.times
        for name, values in (("centre_cell", centre_cell), ("pose", poses), ("time", times)):
            out.add(name, values.dtype, values.shape).extend(values)
        mass = np.zeros((2, H, H), np.float32)
        for t, k in enumerate(frames):
            points = drive.scan(k)
            obstacle = parameters.ground.obstacles(points)
            label = parameters.rays.label(points, obstacle, poses[t] @ sensor_to_body, centre_cell[t], origin, spec)
            prior = np.zeros_like(mass) if t in starts else mass
            mass = evidence.step(prior, label, centre_cell[t] - centre_cell[max(t - 1, 0)], parameters.evidence)
            labels.append(label)
            masses.append(mass.astype(np.float16))
            on_frame()
    return T


def _chosen(found: list[Drive], names: list[str] | None) -> list[Drive]:
    if names is None:
        return found
    known = {drive.name: drive for drive in found}
    missing = [name for name in names if name not in known]
    if missing:
        raise UserError(f"no drive named {', '.join(missing)} in the source; it has {', '.join(known)}")
    return [known[name] for name in dict.fromkeys(names)]


def _check(drives: list[Drive]) -> tuple[list[Drive], list[str]]:
    """The drives that have frames, their poses read, and a line for each of the others."""
    ready, failures = [], []
    for drive in tqdm(drives, "reading poses", unit="drive", leave=False, delay=1):
        try:
            if not drive.frames:
                raise UserError(f"{drive.name}: no frame has both a scan and a pose; check that both are unpacked")
            ready.append(drive)
        except UserError as error:
            failures.append(str(error))
        except OSError as error:
            failures.append(f"{error.filename}: {drive.name} cannot be read ({error.strerror})")
    return ready, failures


def _compile(parameters: MappingParameters) -> None:
    """Compile the mapping before the workers start, so that it happens once and is announced if it takes a while."""
    wait = "compiling the mapping for this machine: some seconds, kept on disk for the next time"
    notice = threading.Timer(1.0, _say, [wait])
    notice.daemon = True
    notice.start()
    try:
        spec = GridSpec()
        points = np.ones((1, 4), np.float32)
        obstacle = parameters.ground.obstacles(points)
        origin, centre = np.zeros(2), np.zeros(2, np.int32)
        label = parameters.rays.label(points, obstacle, np.eye(4), centre, origin, spec)
        evidence.step(np.zeros((2, *label.shape), np.float32), label, centre, parameters.evidence)
    finally:
        notice.cancel()


def _attempt(
    drive: Drive, on_frame: Callable[[], None], *, store: Path, parameters: MappingParameters, key: str
) -> str | None:
    """Map one drive; a failure that the user can mend comes back as its line, so that other drives go on."""
    try:
        if not store.is_dir():
            raise UserError(f"{store}: not to be seen from {platform.node()}; give a folder that all workers share")
        map_drive(drive, store, parameters, key, on_frame)
    except UserError as error:
        return str(error)
    except OSError as error:
        place = error.filename or store
        return f"{place}: {drive.name} was not mapped ({error.strerror}); make room or mend the folder, and run again"
    return None


def _drives(count: int) -> str:
    return f"{count} drive{'' if count == 1 else 's'}"


def _say(line: str) -> None:
    tqdm.write(line, file=sys.stderr)
