"""`envpred bag`: what planners and their tools read of forecasts and drives, as an MCAP recording or a picture."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from envpred.drives import find_drives
from envpred.drives.drive import Drive
from envpred.errors import UserError
from envpred.horizons import asked_steps, shown_steps
from envpred.live.from_store import now_grid, placed_window
from envpred.live.mcap import ENDING, check_extra, write_recording
from envpred.live.messages import BODY, SENSOR, Messages, motion
from envpred.live.occupancy_grid import OccupancyGrid, forecast_grids, maximum
from envpred.live.placed import PlacedForecast
from envpred.live.truth import Truth
from envpred.mapping.geometry import FloatArray
from envpred.pictures import costmaps
from envpred.pictures.grids import check_picture, save
from envpred.results.predictions import Predictions
from envpred.store import Store, StoredDrive

MAXIMUM = "/forecast/maximum"  # the topic of the largest value over the horizons


def bag(
    out: Path,
    predictions: Path | None = None,
    store: Path | None = None,
    source: Path | None = None,
    drive: str | None = None,
    horizons: list[float] | None = None,
    window: int = 0,
) -> None:
    """Write forecasts and drives for planners: a recording for ROS 2 (.mcap), or a picture of what a costmap makes.

    Args:
        out: recording (.mcap, extra `mcap`), or picture (.png, .pdf) of one window.
        predictions: folder that `envpred predict` wrote; needs --store.
        store: folder of the grids that were forecast from: adds the map of every frame, and where the ego is.
        source: folder with drives: adds scans, boxes where there are any, and the class of every simulated point.
        drive: name of the drive; by default the first.
        horizons: in seconds; by default all in a recording, those of the paper in a picture.
        window: of a picture, its place among the drive's windows.
    """
    if out.suffix != ENDING:
        _check_picture(out)
    given = _given(predictions, store, source, drive)
    if out.suffix == ENDING:
        print(f"{out}: {_record(given, out, horizons)}")
    else:
        print(save(_costmaps(given, horizons, window), out))


class _Forecasts(NamedTuple):
    """The forecasts of one drive."""

    predictions: Predictions
    store: Store
    windows: list[int]  # of the predictions, those of the drive


class _Given(NamedTuple):
    """What there is of one drive, at least one of these."""

    name: str
    drive: Drive | None
    stored: StoredDrive | None
    forecasts: _Forecasts | None


class _Track(NamedTuple):
    """Where the ego was: frame numbers, poses (T, 4, 4), times (T,), and the sensor's place (4, 4) in the body."""

    frames: list[int]
    poses: FloatArray
    times: FloatArray
    sensor_to_body: FloatArray


def _check_picture(out: Path) -> None:
    try:
        check_picture(out)
    except UserError:
        raise UserError(
            f"{out}: end its name on {ENDING} for a recording, or on .png, .pdf or .svg for a picture"
        ) from None


def _given(predictions: Path | None, store: Path | None, source: Path | None, name: str | None) -> _Given:
    """The drive of that name, by default the first."""
    if predictions is None and store is None and source is None:
        raise UserError("give what to write: --predictions and their --store, or --store, or drives as --source")
    grids = Store(store) if store is not None else None
    drives = {drive.name: drive for drive in find_drives(source)} if source is not None else {}
    found, asked = None, [(store, list(grids.drives if grids else ())), (source, list(drives))]
    if predictions is not None:
        found = Predictions(predictions)
        if grids is None:
            raise UserError(f"{predictions}: give the grids that were forecast from as --store")
        if found.manifest["role"] == "oracle":
            raise UserError(f"{predictions}: forecasts of an oracle, which reads the future; give those of another")
        asked.insert(0, (predictions, list(dict.fromkeys(window["drive"] for window in found.windows))))
    asked = [(place, names) for place, names in asked if place is not None]
    name = name or next(iter(asked[0][1]), "")
    for place, names in asked:
        if name not in names:
            raise UserError(f"{place}: holds no drive {name}; it has {', '.join(names) or 'none'}")
    forecasts = None
    if found is not None and grids is not None:
        windows = [k for k, window in enumerate(found.windows) if window["drive"] == name]
        forecasts = _Forecasts(found, grids, windows)
    return _Given(name, drives.get(name), grids.drives[name] if grids is not None else None, forecasts)


def _costmaps(given: _Given, horizons: list[float] | None, window: int) -> Figure:
    """What a costmap makes of one window."""
    if given.forecasts is None:
        raise UserError("a picture shows a forecast; give --predictions and their --store")
    predictions, store, windows = given.forecasts
    if not 0 <= window < len(windows):
        raise UserError(f"--window {window}: there are {len(windows)} of {given.name}, counted from 0")
    placed = placed_window(predictions, windows[window], store)
    grids = forecast_grids(placed)
    steps = shown_steps(len(grids), placed.period)
    if horizons is not None:
        steps = tuple(asked_steps(horizons, len(grids), placed.period))
    shown = [
        costmaps.Shown(n * placed.period, grids[n - 1].rows, placed.resolution, grids[n - 1].origin) for n in steps
    ]
    east, north = (np.array(placed.origin) + placed.resolution * placed.now[:2]).tolist()
    frame = predictions.windows[windows[window]]["frames"][-1]
    return costmaps.costmaps(shown, (east, north), f"{given.name}, frame {frame}")


def _record(given: _Given, out: Path, horizons: list[float] | None) -> str:
    """Write the recording; returns what is in it."""
    check_extra()
    frames, poses, times, sensor_to_body = _track(given)
    truth = Truth.of(given.drive) if given.drive is not None else Truth()
    predictions, store, windows = given.forecasts or (None, None, [])
    last = {predictions.windows[k]["frames"][-1]: k for k in windows} if predictions is not None else {}
    velocity, turn_rate = motion(poses, times)
    with write_recording(out) as recording:
        messages = Messages(recording.types)
        where = messages.transform(sensor_to_body, times[0], BODY, SENSOR)
        recording.write("/tf_static", where, times[0], latched=True)
        for t, frame in enumerate(tqdm(frames, "writing", unit="frame", leave=False, delay=1, disable=None)):
            time = float(times[t])
            recording.write("/tf", messages.transform(poses[t], time), time)
            recording.write("/odometry", messages.odometry(poses[t], velocity[t], turn_rate[t], time), time)
            if given.drive is not None:
                scan = given.drive.scan(frame)
                recording.write("/points", messages.points(scan, time, truth.classes(frame, len(scan))), time)
            if truth.tracklets:
                recording.write("/truth/boxes", messages.boxes(truth.tracklets, frame, time), time)
            if given.stored is not None:
                recording.write("/grid", messages.grid(now_grid(given.stored, t)), time, latched=True)
            if frame in last and predictions is not None and store is not None:
                for topic, grid in _forecast(placed_window(predictions, last[frame], store), horizons):
                    recording.write(topic, messages.grid(grid), time, latched=True)
    counts = {
        "scans": len(frames) if given.drive is not None else 0,
        "boxes": len(truth.tracklets),
        "forecasts": len(windows),
    }
    return ", ".join([f"{len(frames)} frames of {given.name}", *(f"{n} {name}" for name, n in counts.items() if n)])


def _forecast(placed: PlacedForecast, horizons: list[float] | None) -> Iterator[tuple[str, OccupancyGrid]]:
    """The horizons of one window, each with a topic of its own, and their maximum."""
    grids = forecast_grids(placed)
    if horizons is not None:
        grids = [grids[n - 1] for n in asked_steps(horizons, len(grids), placed.period)]
    for grid in grids:
        yield topic_of(grid.stamp - placed.time), grid
    yield MAXIMUM, maximum(grids)


def topic_of(ahead: float) -> str:
    """The topic of the forecast so many seconds ahead; names of ROS hold no points, and no part begins with a digit."""
    return f"/forecast/in_{round(1000 * ahead):04d}_ms"


def _track(given: _Given) -> _Track:
    """The frames of the grids where there are any, and of the drive elsewhere.

    Raises:
        UserError: if both are given, but not of the same recording.
    """
    drive, stored = given.drive, given.stored
    if stored is None:
        assert drive is not None  # one of them is there
        return _Track(drive.frames, drive.poses, drive.times, drive.sensor_to_body())
    poses, times = (np.array(stored.array(name), np.float64) for name in ("pose", "time"))
    if drive is not None:
        own = dict(zip(drive.frames, drive.poses, strict=True))
        if not all(
            np.allclose(own.get(k, np.inf), pose, atol=1e-3) for k, pose in zip(stored.frames, poses, strict=True)
        ):
            raise UserError(
                f"{stored.folder}: was mapped from other frames or poses than the drive in --source has; give the "
                "folder that it was mapped from"
            )
    return _Track(stored.frames, poses, times, stored.sensor_to_body)
