"""Draws one window of predictions or test runs, the forecasts of several methods beside each other."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from envpred.drives import one_drive
from envpred.errors import UserError
from envpred.horizons import asked_steps
from envpred.pictures.animations import scene_animation
from envpred.pictures.forecasts import Camera, scene_strip
from envpred.pictures.grids import check_picture, save
from envpred.report.pictures import drawn_scenes
from envpred.report.runs import found_in, read_run
from envpred.results.predictions import Predictions
from envpred.results.result import RESULT
from envpred.results.scenes import Scene, together
from envpred.store import MANIFEST, Store

Key = tuple[str, int]  # drive and last frame shown


@dataclass(frozen=True)
class _Method:
    """What one folder forecasts."""

    folder: Path
    label: str
    windows: Sequence[Key]
    scene: Callable[[int, str], Scene]


def draw(
    folders: Sequence[Path],
    out: Path,
    window: int = 0,
    store: Path | None = None,
    source: Path | None = None,
    horizons: Sequence[float] | None = None,
    circles: bool = True,
) -> str:
    """Draw a window into `out`; returns a line that says what was drawn.

    Args:
        folders: predictions, or test runs, whose drawn windows are taken; those without are left out, with a line on
            standard error.
        out: picture, or .gif that plays the window.
        window: place of the window among those of the first folder; the others are searched for it.
        store: grids that were forecast from.
        source: folder with drives, for the pictures of their camera.
        horizons: of a strip, in seconds.
        circles: circle the ego and what moves in a strip.

    Raises:
        UserError: if no folder holds forecasts, or one lacks the window, or was forecast from other grids.
    """
    check_picture(out, or_animation=True)
    grids = Store(store) if store is not None else None
    remedy = "name what `envpred predict` wrote, or a run of `envpred test` that drew some windows"
    methods = found_in(folders, lambda folder: _opened(folder, grids), "forecasts", remedy)
    windows = methods[0].windows
    if not 0 <= window < len(windows):
        raise UserError(f"--window {window}: {methods[0].folder} has {len(windows)} windows, counted from 0")
    labels = [method.label for method in methods]
    scenes = []
    for n, method in enumerate(methods):
        if windows[window] not in method.windows:
            drive, frame = windows[window]
            raise UserError(
                f"{method.folder}: has no forecast of {drive} after frame {frame}, as {methods[0].folder} has as its "
                f"window {window}"
            )
        label = method.label if labels.count(method.label) == 1 else f"{method.label}, {n + 1}"
        scenes.append(method.scene(method.windows.index(windows[window]), label))
    scene = together(scenes)
    steps = None if horizons is None else asked_steps(horizons, scene.horizons, scene.period)
    picture = scene_animation(scene) if out.suffix == ".gif" else None
    save(picture or scene_strip(scene, steps, camera_of(scene.drive, source), circles=circles), out)
    return f"{out}: {scene.where}"


def _opened(folder: Path, store: Store | None) -> _Method | None:
    """The forecasts in `folder`, if there are any: predictions, a run that wrote some, or a test run."""
    place = next((place for place in (folder, folder / "predictions") if (place / MANIFEST).is_file()), None)
    if place is not None:
        found = Predictions(place)
        windows = [(str(entry["drive"]), int(entry["frames"][-1])) for entry in found.windows]
        return _Method(folder, found.label, windows, lambda k, label: found.scene(k, store, label))
    if (folder / RESULT).is_file():
        run = read_run(folder / RESULT)
        scenes = list(drawn_scenes(run).values())
        if not scenes:
            return None
        keys = [(scene.drive, scene.frames[-1]) for scene in scenes]
        return _Method(folder, run.label, keys, lambda k, label: scenes[k].named(label))
    return None


def camera_of(drive: str, source: Path | None) -> Camera | None:
    """The camera's pictures of a drive in the folder `source`, if one is given.

    Raises:
        UserError: if the folder lacks the drive.
    """
    return None if source is None else one_drive(source, drive).image
