"""Sets of drives that a name asks for, and what a simulation is going to make, told before it begins."""

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

SLOWEST, FASTEST = 3.0, 12.5  # m/s: mean speeds that egos are looked for at
SCAN_BYTES = 2_600_000  # a scan with its labels on disk
GRID_BYTES = 560_000  # a scan's grids on disk, with a wide one of 256 cells and velocities
_GOLDEN = (5**0.5 - 1) / 2


class Preset(NamedTuple):
    """How many drives of how many scans."""

    drives: int
    frames: int


PRESETS = {
    "look": Preset(10, 150),  # for the demo, and a first training
    "train": Preset(60, 170),  # 10,200 scans: what weights are trained on that ship
}


def pace(seed: int, number: int) -> float:
    """The mean speed in m/s that a drive's ego is looked for at.

    Multiples of the golden ratio spread evenly, however many drives there are.
    """
    offset = np.random.default_rng([seed, 0]).random()
    return float(SLOWEST + (FASTEST - SLOWEST) * ((offset + number * _GOLDEN) % 1.0))


def town(seed: int, number: int, towns: Sequence[int]) -> int:
    """The number of a drive's town.

    Every block of as many drives as there are `towns` visits each once, in an order of its own.
    """
    block, turn = divmod(number - 1, len(towns))
    return int(np.random.default_rng([seed, 0, block]).permutation(towns)[turn])


def plan(drives: int, frames: int, seed: int, towns: Sequence[int], names: Sequence[str], asked: str) -> list[str]:
    """Lines that say what a simulation makes.

    Args:
        drives: number of drives.
        frames: scans a drive.
        seed: of all.
        towns: numbers of those that drives may lie in.
        names: of all towns.
        asked: hash of what decides the drives.
    """
    numbers = range(1, drives + 1)
    visited = Counter(names[town(seed, number, towns)] for number in numbers)
    speeds = np.quantile([pace(seed, number) for number in numbers], [0, 0.5, 1])
    scans = drives * frames
    return [
        f"plan: {drives} drives of {frames} scans, {scans:,} in all; seed {seed}, hash {asked}",
        f"towns: {', '.join(f'{name} {count}' for name, count in sorted(visited.items()))}; egos at about "
        f"{speeds[0]:.1f} to {speeds[2]:.1f} m/s, half of them below {speeds[1]:.1f}",
        f"disk: {scans * SCAN_BYTES / 1e9:.1f} GB, and about {scans * GRID_BYTES / 1e9:.1f} GB for grids of "
        "`envpred grids --config rollout`",
    ]
