"""The per-drive job: drive -> mapping -> store, in local processes or on a Dask cluster."""

import functools
import platform
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from envpred.build.every import thinned
from envpred.build.glances import Glances
from envpred.build.jobs import run_jobs, say
from envpred.build.moving import PARAMETERS as MOVING
from envpred.build.moving import add_moving
from envpred.build.stated import as_stated
from envpred.drives import Drive, find_drives
from envpred.drives.plausible import oddities
from envpred.errors import UserError
from envpred.interrupts import ends_at_once
from envpred.mapping.geometry import PAPER_SENSOR_OFFSET, FloatArray
from envpred.mapping.mapper import Mapped, Mapper, MappingParameters
from envpred.store import GROUPS, ArrayWriter, DriveWriter, Store, StoredDrive, sweep

if TYPE_CHECKING:  # it brings torch along, which only velocities need
    from envpred.mapping.dogma import DogmaParameters


def build(
    source: Path,
    store: Path,
    parameters: MappingParameters | None = None,
    drives: list[str] | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    force: bool = False,
    context: int | None = None,
    reader: str | None = None,
    tracklets: bool = True,
) -> None:
    """Map every drive under `source` that the store does not hold yet.

    Args:
        source: folder with drives.
        store: folder for the grids.
        parameters: of the method.
        drives: names of the drives; by default all.
        workers: local processes; by default one a core.
        cluster: address of a Dask scheduler.
        force: map again what is there, also with other parameters.
        context: cells of a wider grid that is mapped beside the judged one, and added to drives that lack it.
        reader: the only reader that is asked for drives, as module.function; by default all are.
        tracklets: say which cells move, too, of drives with boxes of tracked objects.

    Raises:
        UserError: if drives fail (after the others are done), or the store does not fit, or is not apart from the
            source.
    """
    if workers is not None and workers < 1:
        raise UserError(f"--workers {workers}: give at least 1")
    parameters = parameters or MappingParameters()
    with ends_at_once():  # readers bring libraries of their own
        found = [thinned(drive, parameters.every) for drive in _chosen(find_drives(source, reader), drives)]
    parameters, context = as_stated(found, parameters, context)
    if context is not None:
        parameters.grid.wider(context)  # refuses what does not fit
    _check_apart(source, store)
    target = Store(store)
    keys = {"mapping": target.claim("mapping", parameters.as_dict(), force=force)}
    if context is not None:
        keys["context"] = target.claim("context", {"cells": context}, force=force)
    with_boxes = {drive.name for drive in found if tracklets and drive.has_tracklets}
    moving = {"moving": target.claim("moving", MOVING, force=force)} if with_boxes else {}
    sweep(store)
    asked = {drive.name: keys | (moving if drive.name in with_boxes else {}) for drive in found}
    lacking = {name: wanted if force else target.lacking(name, wanted) for name, wanted in asked.items()}
    todo = [drive for drive in found if lacking[drive.name]]
    if not todo:
        say(f"nothing to do: {store} holds {_drives(len(found))} of {source}")
        return
    say(f"{_drives(len(todo))} to map, {len(found) - len(todo)} of {len(found)} in {store} already")
    start = time.monotonic()
    ready, failures = _check(todo)
    ready.sort(key=lambda drive: -len(drive.frames))  # the longest first, so that no worker is left with it at the end
    job = functools.partial(_attempt, store=store.resolve(), parameters=parameters, lacking=lacking, context=context)
    if any(lacking[drive.name].keys() - moving for drive in ready) and not cluster:
        with ends_at_once():  # the compiler has C callbacks, in which the exception of a Ctrl-C would be lost
            _compile(parameters, context)
    try:
        mapped = run_jobs(job, ready, "mapping", workers, cluster, failures)
    finally:
        sweep(store)  # what workers had begun when they were ended
        stored = Store(store).drives
        for line in (line for drive in ready if drive.name in stored for line in stored[drive.name].warnings):
            say(f"warning: {line}")
    say(f"{_drives(len(todo))}, {mapped} frames mapped into {store} in {time.monotonic() - start:.0f} s")


def mapper_of(
    drive: Drive,
    parameters: MappingParameters,
    context: int | None = None,
    velocities: "DogmaParameters | None" = None,
    with_forecast: bool = False,
) -> Mapper:
    """A mapper for the scans of `drive`, on the lattice that its poses span; see `Mapper` for the arguments."""
    return Mapper(
        parameters,
        drive.body,
        PAPER_SENSOR_OFFSET if parameters.sensor == "paper" else drive.sensor_to_body(),
        parameters.grid.lattice_origin(drive.poses[:, :3, 3]),
        drive.period,
        sensor_height=drive.sensor_height,
        context=context,
        velocities=velocities,
        with_forecast=with_forecast,
    )


def mapped(
    drive: Drive, mapper: Mapper, look: Callable[[NDArray[np.float32], Mapped], None] | None = None
) -> Iterator[Mapped]:
    """What `mapper` makes of the frames of `drive`; it starts anew after a gap: what lies between is not known.

    `look` is shown each scan with what was made of it.
    """
    starts = {first for first, _ in drive.stretches()}
    for t, k in enumerate(drive.frames):
        if t in starts:
            mapper.reset()
        points = drive.scan(k)
        made = mapper.step(points, drive.poses[t], float(drive.times[t]))
        if look is not None:
            look(points, made)
        yield made


def map_drive(
    drive: Drive,
    store: Path,
    parameters: MappingParameters,
    keys: Mapping[str, str],
    context: int | None = None,
    on_frame: Callable[[], None] = lambda: None,
) -> int:
    """Map one drive, frame by frame, into the store; returns its number of frames.

    Args:
        drive: to be mapped.
        store: folder of the store, which must exist.
        parameters: of the method.
        keys: groups to write and the hashes of their parameters: `mapping`, `context` or both.  `context` alone
            completes a drive that is there.
        context: cells of the wider grid.
        on_frame: called after each frame.

    Raises:
        UserError: if a drive that is to be completed was mapped from other frames, or scans, poses or stamps cannot be
            those of a car's drive.
    """
    mapper = mapper_of(drive, parameters, context)
    told, glances = oddities(drive, mapper.sensor_to_body), Glances(len(drive.frames), drive.sensor_height)
    T, H, W = len(drive.frames), mapper.grid.cells, mapper.context.cells if mapper.context else 0
    assert mapper.origin is not None  # the drive's poses give it
    about = _about(drive, mapper, mapper.origin)
    if "mapping" not in keys:
        _check_same(StoredDrive(store / drive.name), about)
        about = {"lattice": about["lattice"]}
    main, *beside = sorted(keys, key=list(GROUPS).index)
    with DriveWriter(store, drive.name, main, keys[main], about, {group: keys[group] for group in beside}) as out:
        written: list[tuple[ArrayWriter, str]] = []
        if "mapping" in keys:
            written.append((out.add("label", np.uint8, (T, H, H)), "label"))
            written.append((out.add("evidence", np.float16, (T, 2, H, H)), "mass"))
            centre_cell = mapper.grid.cell_of(drive.poses[:, :3, 3], mapper.origin)
            for name, values in (("centre_cell", centre_cell), ("pose", drive.poses), ("time", drive.times)):
                out.add(name, values.dtype, values.shape).extend(values)
        if "context" in keys:
            written.append((out.add("context_label", np.uint8, (T, W, W), "context"), "context_label"))
            written.append((out.add("context_evidence", np.float16, (T, 2, W, W), "context"), "context_mass"))
        for frame in mapped(drive, mapper, glances.look):
            for writer, field in written:
                writer.append(getattr(frame, field))
            on_frame()
        out.about = {**about, "warnings": [*told, *glances.oddities(drive.name)]}
    return T


def _about(drive: Drive, mapper: Mapper, origin: FloatArray) -> dict[str, Any]:
    """What the manifest says beside the arrays."""
    return {
        "drive": drive.name,
        "frames": drive.frames,
        "stretches": drive.stretches(),
        "source": {"drive": drive.name, "frames": len(drive.frames)}
        | ({"poses": f"estimated by {drive.estimated_by}"} if drive.estimated_by else {}),
        "lattice": {
            "origin": origin.tolist(),
            "resolution": mapper.grid.resolution,
            "cells": mapper.grid.cells,
            "context": mapper.context.cells if mapper.context else None,
        },
        "period": mapper.period,
        "sensor": mapper.sensor_to_body.tolist(),
        "body": asdict(mapper.body),
    }


def _check_apart(source: Path, store: Path) -> None:
    """Refuse a store that could get into the way of the recordings."""
    drives, grids = source.resolve(), store.resolve()
    if drives == grids or drives in grids.parents or grids in drives.parents:
        how = "is" if drives == grids else "lies in" if drives in grids.parents else "holds"
        raise UserError(f"--store {store}: {how} the source {source}; give a folder apart from the drives")


def _check_same(stored: StoredDrive, about: Mapping[str, Any]) -> None:
    """Refuse to complete a drive with grids that would lie elsewhere than those it holds."""
    there = (stored.frames, stored.manifest["lattice"]["origin"])
    if there != (about["frames"], about["lattice"]["origin"]):
        raise UserError(
            f"{stored.folder}: was mapped from other frames or poses than the source has now; "
            f"delete {stored.folder} and run again"
        )


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


def _compile(parameters: MappingParameters, context: int | None = None) -> None:
    """Compile the mapping before the workers start, so that it happens once and is announced if it takes a while."""
    wait = "compiling the mapping for this machine: some seconds, kept on disk for the next time"
    notice = threading.Timer(1.0, say, [wait])
    notice.daemon = True
    notice.start()
    try:
        Mapper(parameters, context=context).step(np.ones((1, 4), np.float32), np.eye(4), 0.0)
    finally:
        notice.cancel()


def _attempt(
    drive: Drive,
    on_frame: Callable[[], None],
    *,
    store: Path,
    parameters: MappingParameters,
    lacking: Mapping[str, Mapping[str, str]],
    context: int | None,
) -> str | None:
    """Map one drive; a failure that the user can mend comes back as its line, so that other drives go on."""
    try:
        if not store.is_dir():
            raise UserError(f"{store}: not to be seen from {platform.node()}; give a folder that all workers share")
        keys = dict(lacking[drive.name])
        moving = keys.pop("moving", None)
        if keys:
            map_drive(drive, store, parameters, keys, context, on_frame)
        if moving is not None:
            add_moving(drive, store, moving, (lambda: None) if keys else on_frame)
    except UserError as error:
        return str(error)
    except OSError as error:
        place = error.filename or store
        return f"{place}: {drive.name} was not mapped ({error.strerror}); make room or mend the folder, and run again"
    return None


def _drives(count: int) -> str:
    return f"{count} drive{'' if count == 1 else 's'}"
