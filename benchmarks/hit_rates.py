"""Fits the hit rates and says how well they do on drives that were left out, one after the other.

    python -m benchmarks.hit_rates NARROW:WIDE[:WEIGHT] ... [--write envpred/mapping/hit_rates.json]

Each argument is a pair of stores of the same drives, with the judged and with the context grid; a drive of it counts
WEIGHT (1 if left out).  For every pair, its drives are left out by turns (at most FOLDS parts), the weights are fitted
on all others; the log-loss is printed beside that of the weights that ship and of the drive's own share of hits.
"""

import argparse
import json
import textwrap
from pathlib import Path

import numpy as np

from benchmarks.timing import print_table
from envpred.mapping import hit_rates
from envpred.mapping.geometry import OCCUPIED, heading_of
from envpred.mapping.hit_rate_fit import Examples, examples, fit, log_loss
from envpred.mapping.hit_rates import HitRates
from envpred.store import Store

FOLDS = 2


def read(narrow: str, wide: str, every: int) -> dict[str, Examples]:
    """Examples of the drives of a pair of stores; the judged grid's labels and masses stand in the middle."""
    judged, context, found = Store(narrow).drives, Store(wide).drives, {}
    for name, drive in judged.items():
        labels = np.array(context[name].array("label"))
        masses = np.array(context[name].array("evidence"), np.float32)
        cells, resolution = drive.array("label").shape[-1], drive.manifest["lattice"]["resolution"]
        rim = (labels.shape[-1] - cells) // 2
        inner = (..., slice(rim, rim + cells), slice(rim, rim + cells))
        labels[inner], masses[inner] = drive.array("label"), drive.array("evidence")
        poses = np.array(drive.array("pose"))
        place = (poses[:, :2, 3] - drive.origin) / resolution
        pose = np.concatenate([place, heading_of(poses)[:, None]], axis=1)
        random = np.random.default_rng(0)
        centres = np.array(drive.array("centre_cell"))
        found[name] = examples(labels, masses, centres, pose, resolution, cells, random, every=every)
    return found


def main() -> None:
    """Fit, leave out, print, and write if asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pairs", nargs="+", help="NARROW:WIDE[:WEIGHT], stores of the same drives")
    parser.add_argument("--every", type=int, default=10, help="frames between those from which examples look ahead")
    parser.add_argument("--write", type=Path, help="file for the weights fitted on all")
    arguments = parser.parse_args()
    drives: list[tuple[int, str, float, Examples]] = []
    for number, pair in enumerate(arguments.pairs):
        narrow, wide, *weight = pair.split(":")
        for name, found in read(narrow, wide, arguments.every).items():
            drives.append((number, name, float(weight[0]) if weight else 1.0, found))
    rows = []
    for number in range(len(arguments.pairs)):
        of_pair = [k for k, drive in enumerate(drives) if drive[0] == number]
        for out in filter(len, (of_pair[fold::FOLDS] for fold in range(FOLDS))):
            rest = [drive for k, drive in enumerate(drives) if k not in out]
            rates = fit([d[3] for d in rest], [d[2] for d in rest]) if rest else hit_rates.default()
            for _, name, _, found in (drives[k] for k in out):
                share = float(found.weight[found.label == OCCUPIED].sum())
                bound = -share * np.log(share) - (1 - share) * np.log(1 - share)
                losses = (*log_loss(rates, found), *log_loss(hit_rates.default(), found), bound)
                rows.append((name, *(f"{loss:.4f}" for loss in losses)))
    print_table(("left out", "hit", "seen free", "hit, as shipped", "seen free, as shipped", "hit, share alone"), rows)
    if arguments.write:
        everything = fit([d[3] for d in drives], [d[2] for d in drives])
        arguments.write.write_text(as_json(everything, len(drives)))


def as_json(rates: HitRates, drives: int) -> str:
    """The weights as the package reads them."""
    parts = []
    for name, weights in (("hit", rates.hit), ("seen", rates.seen)):
        numbers = ", ".join(repr(float(f"{w:.4g}")) for w in weights)
        filled = textwrap.fill(numbers, 118, initial_indent="  ", subsequent_indent="  ")
        parts.append(f' "{name}": [\n{filled}\n ]')
    text = f'{{\n "about": "fitted by benchmarks/hit_rates.py on {drives} drives",\n' + ",\n".join(parts) + "\n}\n"
    json.loads(text)
    return text


if __name__ == "__main__":
    main()
