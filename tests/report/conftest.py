"""Results of test runs as the forecasters write them, with errors whose order is known."""

import io
import json
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from PIL import Image

from envpred.callbacks.pictures import Pictures
from envpred.cli import main
from envpred.metrics.calibration import Reliability
from envpred.metrics.horizon_mse import HorizonMSE
from envpred.metrics.overlap import IoU
from envpred.metrics.skill import StaticSkill, skill
from envpred.metrics.windows import WindowMetric, summarise
from envpred.models import FCNForecaster, Forecaster, MovedLastFrame, ParticleForecast, PredNetForecaster
from envpred.report import report
from envpred.results.result import FORMAT, short_name
from envpred.results.scenes import Scene, write_scenes
from tests.remedies import remedy
from tests.store.stores import write_store

HORIZONS, WINDOWS, DRIVES = 15, 30, 10
DRAWN_WINDOWS = (0, WINDOWS - 1)
Values = NDArray[np.float64]
Kind = type[Forecaster]
MakeRun = Callable[..., Path]

# Mean squared error at 1.5 s, and thus the order, of the methods.
LEVEL_OF: dict[tuple[Kind, str], float] = {
    (PredNetForecaster, "dst_static"): 0.0520,
    (PredNetForecaster, "dst_dogma"): 0.0400,
    (PredNetForecaster, "prob_static"): 0.0521,
    (PredNetForecaster, "prob_dogma"): 0.0500,
    (FCNForecaster, "prob_dogma"): 0.070,
    (MovedLastFrame, "prob_static"): 0.065,
    (ParticleForecast, "dst_dogma"): 0.110,
}
STATIC_LEVEL = 0.09


def per_window(level: float, seed: int) -> Values:
    """Errors (WINDOWS, HORIZONS) that grow with the horizon to `level`, hard and easy windows shared by all methods."""
    difficulty = np.random.default_rng(99).uniform(0.5, 1.5, (WINDOWS, 1))
    noise = np.random.default_rng(seed).uniform(0.95, 1.05, (WINDOWS, HORIZONS))
    return level * np.linspace(0.3, 1, HORIZONS) * difficulty * noise


def measured(values: Values, metric: type[WindowMetric] = HorizonMSE) -> dict[str, Any]:
    """`values` (W, N) as a `metric` writes them."""
    return summarise(torch.from_numpy(values), torch.arange(len(values)), metric(HORIZONS).about).as_json()


def reliability() -> dict[str, Any]:
    """A diagram whose first bin is empty."""
    middle = np.linspace(0.05, 0.95, 10)
    count = np.array([0] + [100] * 9)
    parts = torch.from_numpy(np.stack([count, count * middle, count * middle**1.2]))
    return Reliability(parts.expand(HORIZONS, -1, -1)).as_json()


def record(kind: Kind, variant: str, level: float, seed: int = 0) -> dict[str, Any]:
    """A complete result."""
    name = short_name(kind.__name__)
    values, static = per_window(level, seed), per_window(STATIC_LEVEL, 1000)
    gained = skill(torch.from_numpy(values), torch.from_numpy(static), StaticSkill(HORIZONS).about)
    return {
        "format": FORMAT,
        "model": {
            "name": name,
            "class_path": f"{kind.__module__}.{kind.__qualname__}",
            "parameters": 123456,
            "flops": 25_000_000_000 if name == "prednet" else None,
            "hyperparameters": {},
        },
        "role": kind.role,
        "variant": variant,
        "data": {
            "store": "grids",
            "store_hash": "abc123",
            "input_hash": {},
            "variant": variant,
            "split": "auto",
            "part": "test",
            "drives": [f"drive_{d}" for d in range(DRIVES)],
            "windows": [[f"drive_{n % DRIVES}", 20 * (n // DRIVES)] for n in range(WINDOWS)],
            "given": 5,
            "length": 20,
            "window_rule": "windows of 20 frames in order, no overlap",
            "resolution": 1 / 3,
            "movers": "labels",
            "period": 0.1,
            "context": None,
        },
        "seed": 3,
        "revision": "0123456789abcdef",
        "command": f"envpred test --config configs/model/{name}.yaml --data.variant {variant}",
        "horizon_s": [round(0.1 * h, 1) for h in range(1, HORIZONS + 1)],
        "metrics": {
            "mse": measured(values),
            "static_mse": measured(static),
            "skill": gained.as_json(),
            "iou": measured(1 - 5 * values, IoU),
            "reliability": reliability(),
        },
        "checkpoint": None,
        "forecast_seconds_per_window": 0.25,
        "pictures": {},
    }


def draw_windows(folder: Path) -> None:
    """Keep the forecasts of two windows beside the result in `folder`, with the errors that it tells."""
    result = json.loads((folder / "result.json").read_text())
    scenes = {}
    for index in DRAWN_WINDOWS:
        drive, start = result["data"]["windows"][index]
        grids = np.random.default_rng(index).uniform(0.3, 0.6, (20, 16, 16)).astype(np.float32)
        wrong = np.sqrt(result["metrics"]["mse"]["per_window"][index]).astype(np.float32)
        forecast = grids[5:] + wrong[:, None, None]
        frames = tuple(range(start, start + 5))
        place = np.zeros((20, 2), np.int64)
        scenes[index] = Scene(drive, frames, grids[:5], grids[5:], place, {"forecast": forecast}, 1 / 3, 0.1)
    write_scenes(folder / "drawn.npz", scenes)
    (folder / "result.json").write_text(json.dumps(result | {"drawn": "drawn.npz"}))


def animation() -> bytes:
    frames = [Image.fromarray(np.full((40, 80), shade, np.uint8)) for shade in (60, 120, 200)]
    out = io.BytesIO()
    frames[0].save(out, "GIF", save_all=True, append_images=frames[1:], duration=100, loop=0)
    return out.getvalue()


def written(
    root: Path,
    kind: Kind = PredNetForecaster,
    variant: str = "dst_static",
    level: float | None = None,
    seed: int = 0,
    change: Callable[[dict[str, Any]], object] = lambda record: None,
) -> Path:
    """Write a result `record`, changed by a function, into a folder of its own below `root`; returns the folder."""
    folder = root / f"{short_name(kind.__name__)}_{variant}_{len(list(root.glob('*')))}"
    folder.mkdir(parents=True)
    result = record(kind, variant, LEVEL_OF[kind, variant] if level is None else level, seed)
    change(result)
    (folder / "result.json").write_text(json.dumps(result))
    return folder


@pytest.fixture
def make_run(tmp_path: Path) -> MakeRun:
    """`written` below a folder of the test's own."""
    return partial(written, tmp_path / "runs")


@pytest.fixture(scope="session")
def all_runs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """One run of every method, the ends with pictures of their own, all but the last with forecasts."""
    root = tmp_path_factory.mktemp("runs")
    pictures = {f"window_{n}_velocity": "strip.png" for n in (10, 2)}
    pictures |= {"window_2_errors": "strip.png", "window_2_animation": "window.gif"}
    folders = [written(root, kind, variant, seed=n) for n, (kind, variant) in enumerate(LEVEL_OF)]
    for folder in (folders[0], folders[-1]):
        Image.fromarray(np.full((30, 90), 128, np.uint8)).save(folder / "strip.png")
        (folder / "window.gif").write_bytes(animation())
        result = json.loads((folder / "result.json").read_text())
        (folder / "result.json").write_text(json.dumps(result | {"pictures": pictures}))
    for folder in folders[:-1]:
        draw_windows(folder)
    return folders


@pytest.fixture(scope="session")
def page(all_runs: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of all of them."""
    return report(all_runs, tmp_path_factory.mktemp("report"))


@pytest.fixture(scope="session")
def mend(tmp_path_factory: pytest.TempPathFactory) -> Callable[[object], Path]:
    """Runs the command that a message names, with the options of a test run; returns the folder of its result.

    What it writes does not depend on what the message is about, so that one run of a command does for all.
    """
    root = tmp_path_factory.mktemp("mended")
    store = write_store(root / "grids", {name: list(range(40)) for name in "abc"}, cells=8)

    @cache
    def run(command: str) -> Path:
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(root)
            patch.setattr(Pictures, "on_test_end", lambda *_: None)  # drawing takes longer than all else
            main([command, "--model=LastFrame", f"--data.store={store}", "--data.test=[c@-20]"])
        return next(root.rglob("result.json")).parent

    def mended(message: object) -> Path:
        ((command,),) = remedy(message)
        return run(command)

    return mended
