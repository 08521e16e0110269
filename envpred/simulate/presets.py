"""Sets of drives and mixes of towns that a name asks for, and what a simulation makes, told before it begins."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from envpred.errors import UserError, printable

FASTEST = 15.0  # m/s: egos are looked for at mean speeds up to here
STANDING = 0.05  # share of drives whose ego is to stand all the time
SCAN_BYTES = 2_600_000  # a scan with its labels on disk
GRID_BYTES = 560_000  # a scan's grids on disk, with a wide one of 256 cells and velocities
# Multiples of these, modulo 1, spread evenly over 0 to 1 however many there are: speeds, towns, and both together.
_STEPS = (5**0.5 - 1) / 2, 3**0.5 - 1


class Preset(NamedTuple):
    """How many drives of how many scans."""

    drives: int
    frames: int


PRESETS = {
    "look": Preset(10, 150),  # for the demo, and a first training
    "train": Preset(60, 170),  # 10,200 scans: what weights are trained on that ship
}


# Weights of the towns that drives lie in.  A recording's towns that "default" does not name count 1.
MIXES: dict[str, dict[str, float]] = {
    "default": {
        "old_town": 1.0,
        "residential": 1.0,
        "boulevard": 1.0,
        "suburb": 1.0,
        "rural": 2.0,
        "arterial": 1.0,
        "crescents": 1.5,
        "queues": 1.0,
        "car_park": 0.5,
    },
    "towns": {"old_town": 1.0, "residential": 1.0, "boulevard": 1.0, "suburb": 1.0},
}


def weights_of(mix: str, names: Sequence[str]) -> dict[int, float]:
    """Weight by number of the towns that a mix draws from.

    Args:
        mix: a key of `MIXES`, or towns with or without weights: "rural,old_town", "rural=2,boulevard=1".
        names: of a recording's towns.

    Raises:
        UserError: if a name is unknown, one comes twice, or a weight is not above 0.
    """
    if mix in MIXES:
        unnamed = 1.0 if mix == "default" else 0.0
        shares = {k: MIXES[mix].get(name, unnamed) for k, name in enumerate(names)}
        weights = {k: share for k, share in shares.items() if share}
        if not weights:
            raise UserError(f"--mix {mix}: none of its towns is in the recording; there are {', '.join(names)}")
        return weights
    weights = {}
    for part in mix.split(","):
        name, equals, number = (text.strip() for text in part.partition("="))
        if name not in names:
            raise UserError(
                f"--mix {printable(mix)}: no town {printable(name)!r}; give towns ({', '.join(names)}), "
                f"with weights or without (rural=2,suburb=1), or one of the mixes {', '.join(MIXES)}"
            )
        try:
            weight = float(number) if equals else 1.0
        except ValueError:
            weight = math.nan
        if not 0 < weight < math.inf:
            raise UserError(f"--mix {printable(mix)}: the weight of {name} is no number above 0")
        if names.index(name) in weights:
            raise UserError(f"--mix {printable(mix)}: {name} comes twice")
        weights[names.index(name)] = weight
    return weights


def mixed(weights: Mapping[int, float], names: Sequence[str]) -> str:
    """A mix as `weights_of` reads it, the same for all ways to write it: towns in order, with shares of 1."""
    total = sum(weights.values())
    return ",".join(f"{names[k]}={weights[k] / total:.4g}" for k in sorted(weights))


def pace(seed: int, number: int) -> float:
    """The mean speed in m/s that a drive's ego is looked for at: 0 for a share `STANDING`, the others even above."""
    above = (_spread(seed, number, 0) - STANDING) / (1 - STANDING)
    return FASTEST * max(0.0, above)


def town(seed: int, number: int, weights: Mapping[int, float]) -> int:
    """The number of a drive's town; each town gets its share of `weights` of any run of drives, but for one or two."""
    towns = sorted(weights)
    ends = np.cumsum([weights[k] for k in towns])
    return towns[int(np.searchsorted(ends[:-1], _spread(seed, number, 1) * ends[-1], side="right"))]


def _spread(seed: int, number: int, axis: int) -> float:
    """Of a drive's point in the unit square the coordinate `axis`: 0 for its speed, 1 for its town."""
    start = np.random.default_rng([seed, 0]).random(2)[axis]
    return float((start + number * _STEPS[axis]) % 1.0)


def plan(
    drives: int, frames: int, seed: int, weights: Mapping[int, float], names: Sequence[str], asked: str
) -> list[str]:
    """Lines that say what a simulation makes.

    Args:
        drives: number of drives.
        frames: scans a drive.
        seed: of all.
        weights: of the towns that drives may lie in, by number.
        names: of all towns.
        asked: hash of what decides the drives.
    """
    numbers = range(1, drives + 1)
    visited = Counter(names[town(seed, number, weights)] for number in numbers)
    speeds = np.quantile([pace(seed, number) for number in numbers], [0, 0.5, 1])
    scans = drives * frames
    return [
        f"plan: {drives} drives of {frames} scans, {scans:,} in all; seed {seed}, hash {asked}",
        f"towns: {', '.join(f'{name} {count}' for name, count in sorted(visited.items()))}; egos at about "
        f"{speeds[0]:.1f} to {speeds[2]:.1f} m/s, half of them below {speeds[1]:.1f}",
        f"disk: {scans * SCAN_BYTES / 1e9:.1f} GB, and about {scans * GRID_BYTES / 1e9:.1f} GB for grids of "
        "`envpred grids --config rollout`",
    ]
