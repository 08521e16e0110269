"""How well the risk of a path fits what came: Brier scores of the rollout's risk, by rule, on drives of a store.

    python -m benchmarks.risk --store grids/ [--every 110] [--futures 16]

The store is built with `--config rollout`.  Paths leave the ego's true one by -8 to 8 m within 1.5 s, by a parabola.
A path has met something once a cell under the body was measured as occupied, and believed to be by more than 0.8.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch.utils.data import default_collate

from benchmarks.timing import print_table
from envpred.datamodules import GridDataModule
from envpred.horizons import asked_steps
from envpred.live.placed import PlacedForecast
from envpred.live.risk import cells_under, poses_at, risk
from envpred.mapping.evidence import pignistic
from envpred.mapping.geometry import OCCUPIED, FloatArray, heading_of
from envpred.models import RolloutForecaster
from envpred.store import StoredDrive

HORIZONS, ASIDE, BELIEVED = 15, (-8, -5, -2, 0, 2, 5, 8), 0.8
RULES: dict[str, dict[str, Any]] = {
    "two cells of 0.8 at once": {},
    "one cell of 0.8": {"cells": 1},
    "one cell of 0.5": {"cells": 1, "occupied": 0.5},
    "four cells of 0.8": {"cells": 4},
}
LEAST, ALWAYS = "least, without futures", "always their share"


class Case(NamedTuple):
    """A path, the forecast with and without samples, and by when something was met (N,)."""

    plan: FloatArray
    sampled: PlacedForecast
    plain: PlacedForecast
    met: NDArray[np.bool_]


def cases(store: Path, every: int, futures: int) -> Iterator[Case]:
    """Paths of every so many windows of all drives."""
    forecaster = RolloutForecaster(futures=futures, samples=True).eval()
    data = GridDataModule(store, predict="all")
    trainer: Any = SimpleNamespace(lightning_module=forecaster, current_epoch=0)
    data.trainer = trainer
    data.setup("predict")
    windows = data.datasets["predict"]
    for k in range(0, len(windows.places), every):
        drive, now = windows.places[k].drive, windows.places[k].start + forecaster.given - 1
        if now + HORIZONS >= len(drive.frames):
            continue
        seen = default_collate([{"seen": windows[k]["seen"]}])["seen"]
        with torch.inference_mode():
            forecast = forecaster.forecast(seen, HORIZONS)
        drawn = forecaster.futures(seen, HORIZONS)[0].numpy()
        sampled = PlacedForecast.of(forecast, seen, drive.origin, futures=drawn)
        plain = PlacedForecast.of(forecast, seen, drive.origin)
        for aside in ASIDE:
            plan = beside(drive, now, aside)
            yield Case(plan, sampled, plain, met(drive, now, poses_at(plan, plain), plain))


def beside(drive: StoredDrive, now: int, aside: float) -> FloatArray:
    """The ego's true path from frame `now` on, more and more to the left, `aside` metres in the end."""
    poses = np.array(drive.array("pose")[now : now + HORIZONS + 1], np.float64)
    heading, time = np.unwrap(heading_of(poses)), drive.period * np.arange(HORIZONS + 1)
    left = aside * (time / time[-1]) ** 2
    x, y = poses[:, 0, 3] - np.sin(heading) * left, poses[:, 1, 3] + np.cos(heading) * left
    return np.stack([x, y, heading, time], axis=1)


def met(drive: StoredDrive, now: int, poses: FloatArray, forecast: PlacedForecast) -> NDArray[np.bool_]:
    """By which horizons (N,) a body at `poses` (N, 3) has met something."""
    found = []
    for n, pose in enumerate(poses, start=now + 1):
        label, mass = np.array(drive.array("label")[n]), np.array(drive.array("evidence")[n], np.float32)
        there = (label == OCCUPIED) & (pignistic(mass) > BELIEVED)
        under = cells_under(pose, forecast.sensor, forecast.body, forecast.resolution)
        i, j = (under - np.array(drive.array("centre_cell")[n]) + len(label) // 2).T
        inside = (i >= 0) & (i < len(label)) & (j >= 0) & (j < len(label))
        found.append(bool(there[i[inside], j[inside]].any()))
    return np.logical_or.accumulate(found)


def main() -> None:
    """Score every rule at 0.5 and 1.5 s."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--store", type=Path, required=True, help="built with --config rollout")
    parser.add_argument("--every", type=int, default=110, help="of so many windows one")
    parser.add_argument("--futures", type=int, default=16)
    arguments = parser.parse_args()
    told: dict[str, list[FloatArray]] = {name: [] for name in (*RULES, LEAST)}
    came = []
    for case in cases(arguments.store, arguments.every, arguments.futures):
        for name, rule in RULES.items():
            told[name].append(risk(case.plan, case.sampled, **rule).least)
        told[LEAST].append(risk(case.plan, case.plain).least)
        came.append(case.met)
    truth = np.array(came, np.float64)
    forecasts = {name: np.array(values) for name, values in told.items()} | {ALWAYS: truth.mean(axis=0)[None]}
    scores = {name: ((values - truth) ** 2).mean(axis=0) for name, values in forecasts.items()}
    shown = [step - 1 for step in asked_steps((0.5, 1.5), HORIZONS)]
    rows = [(name, *(f"{score[n]:.3f}" for n in shown)) for name, score in scores.items()]
    share = ", ".join(f"{truth[:, n].mean():.3f}" for n in shown)
    print_table((f"Brier score, {len(truth)} paths, {share} of which meet something", "0.5 s", "1.5 s"), rows)


if __name__ == "__main__":
    main()
