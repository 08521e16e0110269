"""The second per-drive job: label grids of a stored drive -> velocities, and the particle forecast where asked for."""

import functools
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch

from envpred.build.jobs import run_jobs
from envpred.errors import UserError
from envpred.mapping import evidence
from envpred.mapping.dogma import DogmaParameters, VelocityFilter
from envpred.mapping.evidence import EvidenceParameters
from envpred.store import DriveWriter, Store, StoredDrive, sweep

ALL = "all"


def build_dogma(
    store: Path,
    parameters: DogmaParameters | None = None,
    drives: list[str] | None = None,
    forecasts: list[str] | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    force: bool = False,
    device: str = "cpu",
) -> None:
    """Add velocities to every drive of the store that has none yet.

    Args:
        store: folder that holds the mapped drives.
        parameters: filter and thresholds.
        drives: names of the drives; by default all of the store.
        forecasts: names of the drives that get the particle forecast too, or `all`; it is the largest array.
        workers: local processes.
        cluster: address of a Dask scheduler.
        force: build again what is there, also with other parameters.
        device: where the filter runs, cpu or cuda.

    Raises:
        UserError: if drives fail, are not there, or the store was built with other parameters, or the device is not
            to be used.
    """
    if cluster is None:  # its workers have devices of their own
        check_device(device)
    parameters = parameters or DogmaParameters()
    target = Store(store)
    names = list(target.drives) if drives is None else drives
    wanted = set(names) if forecasts == [ALL] else set(forecasts or [])
    missing = [name for name in {*names, *wanted} if name not in target.drives]
    if missing:
        raise UserError(f"{store}: holds no drive {', '.join(missing)}; it has {', '.join(target.drives)}")
    target.check({*names, *wanted}, ["label"])
    key = target.claim("dogma", asdict(parameters), force=force)
    todo = [
        drive
        for drive in (target.drives[name] for name in dict.fromkeys([*names, *wanted]))
        if force
        or drive.manifest["groups"].get("dogma") != key
        or (drive.name in wanted and not drive.has("particle_forecast"))
    ]
    measures = EvidenceParameters(**target.parameters("mapping")["evidence"])
    job = functools.partial(
        _add, parameters=parameters, measures=measures, key=key, forecasts=frozenset(wanted), device=device
    )
    try:
        run_jobs(job, todo, "velocities", workers, cluster)
    finally:
        sweep(store)


def check_device(device: str) -> None:
    """Refuse a device that the filter cannot run on in this process.

    Raises:
        UserError: naming it.
    """
    try:
        torch.Generator(device)
    except (RuntimeError, AssertionError) as error:
        reason = " ".join(str(error).split(". ")[0].split())
        raise UserError(f"--device {device}: torch cannot use it here ({reason:.120}); give --device cpu") from None


def _add(
    drive: StoredDrive,
    on_frame: Callable[[], None],
    *,
    parameters: DogmaParameters,
    measures: EvidenceParameters,
    key: str,
    forecasts: frozenset[str],
    device: str,
) -> str | None:
    """Add the group `dogma` to one drive; a failure that the user can mend comes back as its line."""
    torch.set_num_threads(1)  # every core has a drive of its own
    try:
        _write(drive, on_frame, parameters, measures, key, drive.name in forecasts, device)
    except UserError as error:
        return str(error)
    except OSError as error:
        return f"{error.filename or drive.folder}: no velocities for {drive.name} ({error.strerror}); run again"
    return None


def _write(
    drive: StoredDrive,
    on_frame: Callable[[], None],
    parameters: DogmaParameters,
    measures: EvidenceParameters,
    key: str,
    with_forecast: bool,
    device: str,
) -> None:
    T, H = len(drive.frames), drive.grid.cells
    centres, poses = np.array(drive.array("centre_cell")), np.array(drive.array("pose"))
    labels = drive.array("label")
    velocities = VelocityFilter(parameters, drive.grid, drive.period, 0, with_forecast, device)
    starts = {first for first, _ in drive.stretches}
    with DriveWriter(drive.folder.parent, drive.name, "dogma", key, {}) as out:
        velocity = out.add("velocity", np.float16, (T, 2, H, H))
        covariance = out.add("velocity_cov", np.float16, (T, 3, H, H))
        ahead = out.add("particle_forecast", np.uint8, (T, velocities.horizons, H, H)) if with_forecast else None
        for t in range(T):
            if t in starts:  # like evidence, the filter starts anew after a gap
                velocities.reset()
            measured = evidence.measured(np.array(labels[t]), measures)
            frame = velocities.step(measured, centres[t], poses[t, :2, 3])
            velocity.append(frame.velocity)
            covariance.append(frame.covariance)
            if ahead is not None and frame.forecast is not None:
                ahead.append(frame.forecast)
            on_frame()
