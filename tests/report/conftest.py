"""Results of test runs as the forecasters write them, with errors whose order is known."""

import io
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from envpred.report import report
from envpred.results.scenes import Scene, write_scenes

HORIZONS, WINDOWS = 15, 30
DRAWN_WINDOWS = (0, WINDOWS - 1)
Values = NDArray[np.float64]
MakeRun = Callable[..., Path]

# Mean squared error at 1.5 s, and thus the order, of the made-up methods.
LEVEL_OF = {
    ("prednet", "dst_static"): 0.0520,
    ("prednet", "dst_dogma"): 0.0400,
    ("prednet", "prob_static"): 0.0521,
    ("prednet", "prob_dogma"): 0.0500,
    ("fcn", "prob_dogma"): 0.070,
    ("moved_last_frame", "prob_static"): 0.065,
    ("particle_filter", "dst_dogma"): 0.110,
}
STATIC_LEVEL = 0.09


def per_window(level: float, seed: int) -> Values:
    """Errors (WINDOWS, HORIZONS) that grow with the horizon to `level`, hard and easy windows shared by all methods."""
    difficulty = np.random.default_rng(99).uniform(0.5, 1.5, (WINDOWS, 1))
    noise = np.random.default_rng(seed).uniform(0.95, 1.05, (WINDOWS, HORIZONS))
    return level * np.linspace(0.3, 1, HORIZONS) * difficulty * noise


def measured(values: Values) -> dict[str, Any]:
    error = values.std(axis=0, ddof=1) / np.sqrt(len(values))
    return {"mean": values.mean(0).tolist(), "standard_error": error.tolist(), "per_window": values.tolist()}


def record(name: str, variant: str, level: float, seed: int = 0) -> dict[str, Any]:
    """A complete result."""
    values = per_window(level, seed)
    bins = np.linspace(0.05, 0.95, 10)
    static = per_window(STATIC_LEVEL, 1000)
    return {
        "format": 1,
        "model": {
            "name": name,
            "class_path": f"envpred.models.{name}",
            "parameters": 123456,
            "flops": 25_000_000_000 if name == "prednet" else None,
            "hyperparameters": {},
        },
        "variant": variant,
        "data": {
            "store": "grids",
            "store_hash": "abc123",
            "variant": variant,
            "split": "auto",
            "part": "test",
            "drives": ["drive_a", "drive_b"],
            "windows": [["drive_a", 20 * n] for n in range(WINDOWS)],
            "given": 5,
            "length": 20,
            "window_rule": "windows of 20 frames in order, no overlap",
        },
        "seed": 3,
        "revision": "0123456789abcdef",
        "command": f"envpred test --config configs/model/{name}.yaml --data.variant {variant}",
        "horizon_s": [round(0.1 * h, 1) for h in range(1, HORIZONS + 1)],
        "metrics": {
            "mse": measured(values),
            "static_mse": measured(static),
            "skill": {key: measured(1 - values / static)[key] for key in ("mean", "standard_error")},
            "iou": measured(1 - 5 * values),
            "reliability": {
                "ece": [0.02] * HORIZONS,
                "count": [[100] * 10] * HORIZONS,
                "forecast": [bins.tolist()] * HORIZONS,
                "occupied": [[None, *(bins[1:] ** 1.2).tolist()]] * HORIZONS,
            },
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
        scenes[index] = Scene(drive, frames, grids[:5], grids[5:], np.zeros((20, 2), np.int64), {"forecast": forecast})
    write_scenes(folder / "drawn.npz", scenes)
    (folder / "result.json").write_text(json.dumps(result | {"drawn": "drawn.npz"}))


def animation() -> bytes:
    frames = [Image.fromarray(np.full((40, 80), shade, np.uint8)) for shade in (60, 120, 200)]
    out = io.BytesIO()
    frames[0].save(out, "GIF", save_all=True, append_images=frames[1:], duration=100, loop=0)
    return out.getvalue()


def written(
    root: Path,
    name: str = "prednet",
    variant: str = "dst_static",
    level: float | None = None,
    seed: int = 0,
    change: Callable[[dict[str, Any]], object] = lambda record: None,
) -> Path:
    """Write a result `record`, changed by a function, into a folder of its own below `root`; returns the folder."""
    folder = root / f"{name}_{variant}_{len(list(root.glob('*')))}"
    folder.mkdir(parents=True)
    result = record(name, variant, LEVEL_OF[name, variant] if level is None else level, seed)
    change(result)
    (folder / "result.json").write_text(json.dumps(result))
    return folder


@pytest.fixture
def make_run(tmp_path: Path) -> MakeRun:
    """`written` below a folder of the test's own."""
    return partial(written, tmp_path / "runs")


@pytest.fixture(scope="session")
def all_runs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """One run of every made-up method, the ends with a strip and an animation, all but the last with forecasts."""
    root = tmp_path_factory.mktemp("runs")
    pictures = {"strip": "strip.png", "animation of window 0": "window.gif"}
    folders = [written(root, name, variant, seed=n) for n, (name, variant) in enumerate(LEVEL_OF)]
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
