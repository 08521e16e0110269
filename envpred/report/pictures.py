"""The pictures of a report: what the runs' results name, and every method on the same windows."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from envpred.errors import UserError
from envpred.pictures.forecasts import Camera, scene_parts, scene_strip
from envpred.pictures.grids import save
from envpred.report.run import Run
from envpred.results.names import STATIC
from envpred.results.scenes import Scene, read_scenes, together
from envpred.store.files import inside

RELATIVE, ABSOLUTE = 0.02, 1e-5  # between a squared error and that of grids kept as halves


def drawn_scenes(run: Run) -> dict[int, Scene]:
    """The windows of a run that are drawn, by their place among the test windows; none if its result names none.

    Raises:
        UserError: if their file is missing or damaged, or the forecasts in it are not those that were judged.
    """
    if run.record.get("drawn") is None:
        return {}
    file = inside(run.file.parent, run.record["drawn"], run.file)
    scenes = read_scenes(file, run.label, run.is_oracle)
    windows, judged = run.data["windows"], run.mse.per_window
    for index, scene in scenes.items():
        forecast = scene.forecasts[run.label]
        fits = index < len(windows) and windows[index][0] == scene.drive and len(forecast) == len(scene.target)
        if fits and judged is not None and len(forecast) == judged.shape[1]:
            error = np.square(forecast - scene.target).mean(axis=(1, 2))
            fits = np.allclose(error, judged[index], RELATIVE, ABSOLUTE)
        if not fits:
            raise UserError(
                f"{file}: holds other forecasts than {run.file} judged; "
                f"delete {file.parent} and run `envpred test` again"
            )
    return scenes


def compared_scenes(runs: Sequence[Run]) -> list[Scene]:
    """The windows that all runs drew, with the forecast of each, and the static baseline if no run is it.

    Runs that kept no forecasts are left out.

    Raises:
        UserError: if a run's drawn windows do not fit its result, or two runs saw other grids.
    """
    drawn = [scenes for scenes in map(drawn_scenes, runs) if scenes]
    if not drawn:
        return []
    common = [together([scenes[k] for scenes in drawn]) for k in drawn[0] if all(k in scenes for scenes in drawn)]
    if any(run.role == "static" for run in runs):
        return common
    return [replace(scene, forecasts=scene.forecasts | {STATIC: scene.static}) for scene in common]


def save_strips(scene: Scene, name: Path, camera: Camera | None, circles: bool) -> list[Path]:
    """Draw a scene beside its files' `name`, as .pdf and .png; returns the latter, several if one were too long."""
    files = []
    for n, part in enumerate(scene_parts(scene)):
        stem = name.name + f"_part_{n + 1}" * (n > 0)
        strip = scene_strip(part, camera=camera, circles=circles)
        save(strip, name.with_name(f"{stem}.pdf"))
        files.append(save(strip, name.with_name(f"{stem}.png")))
    return files
