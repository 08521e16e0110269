"""The per-drive job: drive -> mapping -> store, in local processes or on a Dask cluster."""

import errno
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
from tqdm import tqdm

from envpred.drives import Drive, find_drives
from envpred.drives.drive import PAPER_SENSOR_OFFSET
from envpred.errors import UserError
from envpred.mapping import evidence
from envpred.mapping.evidence import EvidenceParameters
from envpred.mapping.geometry import GridSpec
from envpred.mapping.ground import GroundSegmenter, MarkovRandomField
from envpred.mapping.label_grid import RayCasting
from envpred.store import DriveWriter, Store


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
    parameters = parameters or MappingParameters()
    found = _chosen(find_drives(source), drives)
    target = Store(store)
    key = target.claim("mapping", parameters.as_dict(), force=force)
    done = {name for name, stored in target.drives.items() if stored.manifest["groups"].get("mapping") == key}
    todo = [drive for drive in found if force or drive.name not in done]
    print(f"{len(found)} drives, {len(found) - len(todo)} of them in {store} already", file=sys.stderr)
    failures: list[str] = []
    total = 0
    for drive in list(todo):
        try:
            if not drive.frames:
                raise UserError(f"{drive.name}: no frame has both a scan and a pose; check that both are unpacked")
            total += len(drive.frames)
        except UserError as error:
            failures.append(str(error))
            todo.remove(drive)
    jobs = (
        _on_cluster(cluster, todo, store, parameters, key)
        if cluster
        else _in_processes(todo, store, parameters, key, workers)
    )
    with tqdm(total=total, unit="frame", disable=not todo, mininterval=0.5) as bar:
        bar.set_description("starting")
        for frames, failure in jobs:
            if frames:
                bar.set_description("mapping")
                bar.update(frames)
            if failure:
                failures.append(failure)
    if failures:
        raise UserError(
            "\n".join([*failures, f"{len(failures)} of {len(found)} drives failed; the others are in {store}"])
        )


def map_drive(
    drive: Drive, store: Path, parameters: MappingParameters, key: str, on_frame: Callable[[], None] = lambda: None
) -> int:
    """Map one drive, frame by frame, into the store; returns its number of frames.

    Evidence starts anew after a gap in the frames: what lies between is not known.
    """
    spec, frames, runs = parameters.grid, drive.frames, drive.runs()
    poses = drive.poses
    sensor_to_body = PAPER_SENSOR_OFFSET if parameters.sensor == "paper" else drive.sensor_to_body()
    origin = spec.lattice_origin(poses[:, :3, 3])
    centre_cell = spec.cell_of(poses[:, :3, 3], origin)
    starts = {first for first, _ in runs}
    T, H = len(frames), spec.cells
    about = {
        "drive": drive.name,
        "frames": frames,
        "runs": runs,
        "lattice": {"origin": origin.tolist(), "resolution": spec.resolution, "cells": spec.cells},
        "source": {"drive": drive.name, "frames": T},
    }
    with DriveWriter(store, drive.name, "mapping", key, about) as out:
        labels = out.add("label", np.uint8, (T, H, H))
        masses = out.add("evidence", np.float16, (T, 2, H, H))
        times = np.array([drive.time(k) for k in frames])
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
    return [known[name] for name in names]


def _attempt(
    drive: Drive, store: Path, parameters: MappingParameters, key: str, on_frame: Callable[[], None] = lambda: None
) -> str | None:
    """Map one drive; a failure that the user can mend comes back as its line, so that other drives go on."""
    try:
        map_drive(drive, store, parameters, key, on_frame)
    except UserError as error:
        return str(error)
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EACCES, errno.EROFS):
            raise
        return (
            f"{store}: {drive.name} was not written ({error.strerror}); make room or give another store, and run again"
        )
    return None


Outcome = Iterator[tuple[int, str | None]]  # frames more, and the line of a drive that failed


def _in_processes(
    drives: list[Drive], store: Path, parameters: MappingParameters, key: str, workers: int | None
) -> Outcome:
    count = min(workers or os.cpu_count() or 1, len(drives))
    if count == 0:
        return
    context = multiprocessing.get_context("spawn")  # fork would copy torch's and numba's threads half
    frames = context.Value("q", 0)
    seen = 0
    pool = ProcessPoolExecutor(count, context, initializer=_enter_worker, initargs=(frames,))
    try:
        waiting: set[Future[str | None]] = {pool.submit(_job, d, store, parameters, key) for d in drives}
        while waiting:
            finished: set[Future[str | None]] = set()
            try:
                for future in as_completed(waiting, timeout=0.5):
                    finished.add(future)
                    yield 0, future.result()
            except TimeoutError:
                pass
            waiting -= finished
            now = frames.value
            yield now - seen, None
            seen = now
    except BaseException:
        # Ctrl-C, or a worker that died: nothing half-built may go on behind our back.
        for process in multiprocessing.active_children():
            process.terminate()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _enter_worker(frames: Any) -> None:
    """Leave Ctrl-C to the parent, and follow it if it is killed."""
    _worker.frames = frames
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # unwinds, so that the unfinished part is removed
    parent = multiprocessing.parent_process()

    def follow() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


_worker = SimpleNamespace(frames=None)  # what a local worker process shares with its parent


def _job(drive: Drive, store: Path, parameters: MappingParameters, key: str) -> str | None:
    def count() -> None:
        with _worker.frames.get_lock():
            _worker.frames.value += 1

    return _attempt(drive, store, parameters, key, count)


def _on_cluster(address: str, drives: list[Drive], store: Path, parameters: MappingParameters, key: str) -> Outcome:
    """One task a drive; Dask gives the task of a worker that died to another one."""
    try:
        import distributed
    except ImportError:
        raise UserError("--cluster needs Dask: pip install 'envpred[cluster]'") from None
    try:
        client: Any = distributed.Client(address, timeout="10s")
    except (OSError, TimeoutError, ValueError) as error:
        raise UserError(
            f"{address}: no Dask scheduler answers there ({error}); start one with `dask scheduler`"
        ) from None
    with client:
        futures = {
            client.submit(_attempt, drive, store.resolve(), parameters, key, pure=False): len(drive.frames)
            for drive in drives
        }
        for future in distributed.as_completed(list(futures)):
            yield futures[future], future.result()
