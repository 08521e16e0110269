"""Times a stream stage by stage on a recorded drive: scan, ground, label, evidence, velocities, forecast.

    python -m benchmarks.live KITTI_ROOT [--drive NAME] [--config rollout | --weights corrected_rollout] [--long 0]

The promises, on two cores, 15 horizons, scans in memory, for the rollout and the best weights that ship
(corrected_rollout): half of the scans are forecast within 60 ms and 99 of 100 within 100 ms, KITTI's rate; the rollout
alone takes at most 40 ms for half of its forecasts.  `--long 10000` sends so many scans, the drive's over and over,
through one stream, and prints latency and memory of each tenth: neither may grow.
"""

import argparse
from pathlib import Path

import numpy as np
import torch

from benchmarks.timing import peak_memory, print_table
from envpred.cli.forecasters import chosen_forecaster
from envpred.drives import Drive, one_drive
from envpred.live.replay import READ, STAGES, WHOLE, Latency, replay, warmed
from envpred.live.stream import Stream
from envpred.models import Forecaster, RolloutForecaster

PROMISES = {WHOLE: {0.5: 60.0, 0.99: 100.0}}  # milliseconds, by share of the scans
ROLLOUT = PROMISES | {"forecast": {0.5: 40.0}}
SHARES = (0.5, 0.95, 0.99)


def stages(forecaster: Forecaster, drive: Drive, rounds: int) -> None:
    """Print how long each stage takes, over so many replays of the drive."""
    promises = ROLLOUT if type(forecaster) is RolloutForecaster else PROMISES
    latency = Latency()
    for _ in range(rounds):
        for _ in replay(warmed(lambda: Stream.of(forecaster, drive), drive), drive, latency):
            pass
    rows = []
    for name in (READ, *STAGES, WHOLE):
        if latency.stages[name]:
            found = {share: 1e3 * float(np.quantile(latency.stages[name], share)) for share in SHARES}
            kept = [
                f"{share:.0%} <= {most:.0f}: {'kept' if found[share] <= most else 'MISSED'}"
                for share, most in promises.get(name, {}).items()
            ]
            rows.append((name, *(f"{ms:.1f}" for ms in found.values()), ", ".join(kept)))
    print_table(
        (f"{torch.get_num_threads()} threads, {latency.scans} scans", "median", "95 %", "99 %", "promise"), rows
    )


def drift(forecaster: Forecaster, drive: Drive, scans: int) -> None:
    """Print latency and memory of each tenth of so many scans through one stream."""
    stream, latency = warmed(lambda: Stream.of(forecaster, drive, warn=lambda said: None), drive), Latency()
    held = [drive.scan(k) for k in drive.frames]
    stream.watch(latency.end)
    rows = []
    for n in range(scans):
        turn, t = divmod(n, len(held))
        latency.begin()
        stream.update(held[t], drive.poses[t], float(drive.times[t]) + turn * (float(drive.times[-1]) + 0.1))
        if (n + 1) % (scans // 10) == 0:
            ms = 1e3 * float(np.median(latency.stages.pop("forecast")))
            rows.append((f"{n + 1}", f"{ms:.1f}", f"{1024 * peak_memory():.0f}"))
            latency.stages.clear()
    print_table(("scans", "forecast, median ms", "peak MiB"), rows)


def main() -> None:
    """Time a stream, and look whether it grows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", type=Path)
    parser.add_argument("--drive")
    parser.add_argument("--config", default="rollout")
    parser.add_argument("--ckpt_path")
    parser.add_argument("--weights", help="that ship, in place of --config")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--long", type=int, default=0)
    given = parser.parse_args()
    torch.set_num_threads(given.threads)
    drive = one_drive(given.source, given.drive)
    fit = [] if given.ckpt_path or given.weights else [f"--config={given.config}"]
    forecaster = chosen_forecaster(fit, given.ckpt_path, given.weights)
    stages(forecaster, drive, given.rounds)
    if given.long:
        drift(forecaster, drive, given.long)


if __name__ == "__main__":
    main()
