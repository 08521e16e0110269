"""Says which mix of towns transfers best to real drives, by what the hit rates that are fitted on it are worth there.

    python -m benchmarks.mixes SIMULATED REAL [--first 60] [--seed 1]

SIMULATED holds grids of `envpred simulate --preset train --seed SEED`, REAL those of real drives, both with a wide
grid.  The hit rates are fitted on the simulated drives alone, a town's drives counting by the town's weight in the mix,
and judged on the `first` frames of each real drive: the log-loss of hits, and of what is seen free.  No others are
looked at: the rest of the drives is for tests.
"""

import argparse
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from benchmarks.hit_rates import examples_of
from benchmarks.timing import print_table
from envpred.mapping.hit_rate_fit import Examples, fit, log_loss
from envpred.simulate.presets import MIXES, town, weights_of
from envpred.simulate.run import builtin_recording
from envpred.simulate.traffic import Recording
from envpred.store import Store


def mixes(names: list[str]) -> dict[str, dict[int, float]]:
    """The mixes that are compared: those with a name, all towns alike, all but one, and one alone."""
    found = {name: weights_of(name, names) for name in MIXES}
    found["even"] = dict.fromkeys(range(len(names)), 1.0)
    for k, name in enumerate(names):
        found[f"default without {name}"] = {n: w for n, w in found["default"].items() if n != k}
    return found | {f"{name} alone": {k: 1.0} for k, name in enumerate(names)}


def losses(
    drives: list[tuple[int, Examples]], real: list[Examples], weights: Mapping[int, float]
) -> list[tuple[float, float]]:
    """Log-losses on each of the `real` drives of hit rates fitted on `drives` (town, examples) in a mix."""
    count = Counter(place for place, _ in drives)
    chosen = [(found, weights[place] / count[place]) for place, found in drives if place in weights]
    rates = fit([found for found, _ in chosen], [weight for _, weight in chosen])
    return [log_loss(rates, found) for found in real]


def main() -> None:
    """Fit in each mix, judge, and print, the best first."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("simulated", type=Path)
    parser.add_argument("real", type=Path)
    parser.add_argument("--first", type=int, default=60, help="frames of each real drive that are looked at")
    parser.add_argument("--seed", type=int, default=1, help="of the simulation")
    parser.add_argument("--every", type=int, default=40, help="frames between those from which examples look ahead")
    given = parser.parse_args()
    names = [network.name for network in Recording.load(builtin_recording()).networks]
    weights = weights_of("default", names)
    drives = [
        (town(given.seed, number, weights), examples_of(drive, given.every))
        for number, drive in enumerate(Store(given.simulated).drives.values(), 1)
    ]
    real = Store(given.real).drives
    judged = [examples_of(drive, 5, given.first) for drive in real.values()]
    rows = []
    for name, mix in mixes(names).items():
        found = losses(drives, judged, mix)
        total = sum(hit + seen for hit, seen in found) / len(found)
        rows.append((total, name, [f"{hit:.4f} {seen:.4f}" for hit, seen in found]))
    header = ("mix", *(f"{name}: hit, seen free" for name in real), "mean of sums")
    print_table(header, [(name, *each, f"{total:.4f}") for total, name, each in sorted(rows)])


if __name__ == "__main__":
    main()
