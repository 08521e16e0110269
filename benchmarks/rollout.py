"""Times the rollout: ego futures, the world, the forecast and its samples, with and without movers.

    python -m benchmarks.rollout --narrow STORE --wide STORE [--velocities STORE] [--rounds 20]

The stores hold the same drives with 128 and 256 cells; one with velocities relative to the ground (built with
`--config configs/grids/ground_velocity.yaml`) adds movers.  The peer is the forecast of the paper's PredNet.
"""

import argparse
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import torch

from benchmarks.timing import medians, print_table
from envpred.mapping import hit_rates
from envpred.mapping.ego_motion import EgoMotion, ego_futures
from envpred.mapping.geometry import FloatArray, heading_of
from envpred.mapping.movers import Moving
from envpred.mapping.rollout import Mapper, Rollout
from envpred.mapping.world import World
from envpred.networks.prednet import PredNet
from envpred.store import Store, StoredDrive

PROMISE, PROMISE_MOVERS = 30, 40  # ms on two cores: 16 futures x 15 horizons, without and with movers
FUTURES, HORIZONS, GIVEN = 16, 15, 5


class Window:
    """What the rollout reads of one window in the middle of a drive, and its steps on that."""

    def __init__(self, narrow: StoredDrive, wide: StoredDrive, moving: StoredDrive | None) -> None:
        last = len(narrow.frames) // 2
        seen = slice(last - GIVEN + 1, last + 1)
        poses, self.times = np.array(narrow.array("pose")[seen]), np.array(narrow.array("time")[seen])
        self.resolution = float(narrow.manifest["lattice"]["resolution"])
        cells = (poses[:, :2, 3] - narrow.origin) / self.resolution
        self.pose = np.concatenate([cells, heading_of(poses)[:, None]], axis=1)
        self.centres = np.array(narrow.array("centre_cell")[seen])
        self.mass = np.array(narrow.array("evidence")[last], np.float32)
        self.label = np.array(narrow.array("label")[last])
        self.labels = np.array(wide.array("label")[seen])
        self.context = np.array(wide.array("evidence")[last], np.float32)
        self.rates, self.rollout = hit_rates.default(), Rollout((0.81, -0.32), beyond=0.0)
        self.futures = self.imagine()
        self.world = self.build()
        self.draws = np.random.default_rng(0).standard_normal((FUTURES, 2))
        if moving:
            self.velocity, self.covariance = (np.array(moving.array(n)[last]) for n in ("velocity", "velocity_cov"))

    def imagine(self) -> FloatArray:
        """Ego futures."""
        random = np.random.default_rng(0)
        return ego_futures(self.pose, self.times, HORIZONS, FUTURES, random, EgoMotion(), self.resolution)

    def build(self) -> World:
        """The world of hit rates."""
        inputs = self.labels, self.centres, self.context, self.futures, self.pose[-1], self.resolution
        return self.rates.world(*inputs, self.rollout.grid.cells)

    def forecast(self, mapper: Mapper = map) -> object:
        """The expected forecast."""
        return self.rollout.expected(self.mass, self.world, self.centres[-1], self.futures, mapper=mapper)

    def samples(self, mapper: Mapper) -> object:
        """Drawn forecasts."""
        random = np.random.default_rng(0)
        return self.rollout.samples(self.mass, self.world, self.centres[-1], self.futures, random, mapper=mapper)

    def with_movers(self, mapper: Mapper) -> object:
        """The expected forecast, what moves carried on."""
        here = self.centres[-1]
        still, movers = Moving().split(self.world, self.label, self.velocity, self.covariance, here, HORIZONS, "ground")
        return self.rollout.expected(self.mass, still, here, self.futures, movers, self.draws, mapper)


def main() -> None:
    """Time one window in the middle of every drive."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--narrow", type=Path, required=True, help="store with the judged grid")
    parser.add_argument("--wide", type=Path, required=True, help="store with the context grid")
    parser.add_argument("--velocities", type=Path, help="store with velocities relative to the ground")
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    wide = Store(arguments.wide).drives
    moving = Store(arguments.velocities).drives if arguments.velocities else {}
    with ThreadPoolExecutor(arguments.threads) as pool:
        for name, drive in Store(arguments.narrow).drives.items():
            time_window(name, Window(drive, wide[name], moving.get(name)), pool.map, arguments.rounds)
    torch.set_num_threads(arguments.threads)
    prednet, frames = PredNet((2, 48, 96, 192)).eval(), torch.rand(1, GIVEN + HORIZONS, 2, 128, 128)
    with torch.inference_mode():
        peer = medians({"peer": lambda: prednet(frames, GIVEN)}, 3)["peer"]
    print(f"\npeer: a forecast of PredNet (2, 48, 96, 192) takes {1e3 * peer:.0f} ms")


def time_window(name: str, window: Window, mapper: Mapper, rounds: int) -> None:
    """Print the medians of one window's steps, and what became of the promises."""
    steps: dict[str, Callable[[], object]] = {
        "ego futures": window.imagine,
        "world of hit rates": window.build,
        "forecast": lambda: window.forecast(mapper),
        "forecast, one thread": window.forecast,
        "samples": lambda: window.samples(mapper),
    }
    if hasattr(window, "velocity"):
        steps["forecast with movers"] = lambda: window.with_movers(mapper)
    seconds = medians(steps, rounds)
    print(f"\n{name}: {FUTURES} futures x {HORIZONS} horizons")
    rows = [(step, f"{1e3 * taken:.2f}", f"{taken / seconds['forecast']:.2f}") for step, taken in seconds.items()]
    print_table(("medians", "ms", "x the forecast"), rows)
    before = seconds["ego futures"] + seconds["world of hit rates"]
    for step, promise in (("forecast", PROMISE), ("forecast with movers", PROMISE_MOVERS)):
        if step in seconds:
            whole = 1e3 * (before + seconds[step])
            kept = "kept" if whole <= promise else "MISSED"
            print(f"promise: futures, world and {step} <= {promise} ms: {whole:.1f}, {kept}")


if __name__ == "__main__":
    main()
