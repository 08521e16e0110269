"""Times forecasts of one window: the rollout, with movers, with the network on top, and PredNet's beside them.

    python -m benchmarks.rollout --store grids/ [--threads 2] [--rounds 20]

The store is built with `--config rollout`.  The promises, on two cores, 16 futures and 15 horizons:
at most 30 ms for the rollout, 40 ms with movers, 60 ms with the network.
"""

import argparse
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import torch

from benchmarks.timing import medians, print_table
from envpred.datamodules import GridDataModule, Seen
from envpred.models import CorrectedRolloutForecaster, Forecaster, MovedLastFrame, PredNetForecaster, RolloutForecaster

HORIZONS = 15
FORECASTERS: dict[str, tuple[Callable[[], Forecaster], float | None]] = {
    "moved last frame": (lambda: MovedLastFrame(fill=0.5), None),
    "rollout, label world, 1 future": (lambda: RolloutForecaster(futures=1, world="label"), None),
    "rollout, label world": (lambda: RolloutForecaster(world="label"), 30.0),
    "rollout, hit rates": (RolloutForecaster, 30.0),
    "rollout, hit rates and movers": (lambda: RolloutForecaster(movers=True), 40.0),
    "corrected world, with movers": (lambda: CorrectedRolloutForecaster(movers=True), 60.0),
    "corrected forecast, with movers": (lambda: CorrectedRolloutForecaster(movers=True, corrects="forecast"), 60.0),
    "PredNet (2, 16, 32, 64)": (lambda: PredNetForecaster(channels=[16, 32, 64]), None),
    "PredNet (2, 48, 96, 192)": (PredNetForecaster, None),
}


def seen_by(forecaster: Forecaster, store: Path) -> Seen:
    """What `forecaster` sees of the first test window."""
    data = GridDataModule(store)
    trainer: Any = SimpleNamespace(lightning_module=forecaster, current_epoch=0)
    data.trainer = trainer
    data.setup("test")
    seen: Seen = next(iter(data.test_dataloader()))["seen"]
    return seen


def forecast(forecaster: Forecaster, store: Path) -> Callable[[], object]:
    """The forecast of one window, all that it reads lying ready."""
    forecaster.eval()
    seen = seen_by(forecaster, store)

    def run() -> object:
        with torch.inference_mode():
            return forecaster.forecast(seen, HORIZONS)

    return run


def main() -> None:
    """Time all in turns, so that a noisy machine meets them alike."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--store", type=Path, required=True, help="built with --config rollout")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=20)
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    work = {name: forecast(make(), arguments.store) for name, (make, _) in FORECASTERS.items()}
    seconds = medians(work, arguments.rounds)
    ours = seconds["rollout, hit rates"]
    rows = []
    for name, (_, promise) in FORECASTERS.items():
        taken = 1e3 * seconds[name]
        verdict = "" if promise is None else f"<= {promise:.0f}: {'kept' if taken <= promise else 'MISSED'}"
        rows.append((name, f"{taken:.1f}", f"{seconds[name] / ours:.2f}", verdict))
    print_table((f"{arguments.threads} threads, medians", "ms a window", "x rollout", "promise"), rows)


if __name__ == "__main__":
    main()
