"""Fits the hit rates and says how well they do on drives that were left out, one after the other.

    python -m benchmarks.hit_rates STORE[:WEIGHT] ... [--write envpred/mapping/hit_rates.json]

The stores hold a wide grid (`envpred grids --context 256`); a drive counts the WEIGHT of its store (1 if left out).
The drives of every store are left out by turns (at most FOLDS parts) and the weights fitted on all others; the log-loss
is printed beside that of the weights that ship and of the drive's own share of hits.
"""

import argparse
import json
import textwrap
from pathlib import Path

import numpy as np

from benchmarks.timing import print_table
from envpred.mapping import hit_rates
from envpred.mapping.geometry import OCCUPIED, FloatArray, heading_of
from envpred.mapping.hit_rate_fit import Examples, examples, fit, log_loss
from envpred.mapping.hit_rates import HitRates
from envpred.store import Store, StoredDrive

FOLDS = 2


def pose_in_cells(drive: StoredDrive) -> FloatArray:
    """Poses (T, 3) of the ego: x and y in cells of the lattice, heading in radians."""
    poses = np.array(drive.array("pose"))
    return np.concatenate([drive.grid.in_cells(poses[:, :2, 3], drive.origin), heading_of(poses)[:, None]], axis=1)


def longest_stretch(drive: StoredDrive) -> slice:
    """Where the most frames without a gap are."""
    first, length = max(drive.stretches, key=lambda stretch: stretch[1])
    return slice(first, first + length)


def examples_of(drive: StoredDrive, every: int, first: int | None = None) -> Examples:
    """Examples of the longest stretch of a drive with a wide grid, or its `first` frames, `every` so many frames."""
    frames, cells = longest_stretch(drive), drive.grid.cells
    if first is not None:
        frames = slice(frames.start, min(frames.stop, frames.start + first))
    labels = np.array(drive.array("context_label")[frames])
    masses = np.array(drive.array("context_evidence")[frames], np.float32)
    rim = (labels.shape[-1] - cells) // 2
    inner = (..., slice(rim, rim + cells), slice(rim, rim + cells))
    labels[inner], masses[inner] = drive.array("label")[frames], drive.array("evidence")[frames]
    centres = np.array(drive.array("centre_cell")[frames])
    pose, random = pose_in_cells(drive)[frames], np.random.default_rng(0)
    resolution = drive.grid.resolution
    return examples(labels, masses, centres, pose, resolution, cells, random, every=every, period=drive.period)


def main() -> None:
    """Fit, leave out, print, and write if asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("stores", nargs="+", help="STORE[:WEIGHT], with a wide grid")
    parser.add_argument("--every", type=int, default=10, help="frames between those from which examples look ahead")
    parser.add_argument("--write", type=Path, help="file for the weights fitted on all")
    arguments = parser.parse_args()
    drives: list[tuple[int, str, float, Examples]] = []
    for number, store in enumerate(arguments.stores):
        folder, *weight = store.split(":")
        for name, drive in Store(folder).drives.items():
            drives.append((number, name, float(weight[0]) if weight else 1.0, examples_of(drive, arguments.every)))
    rows = []
    for number in range(len(arguments.stores)):
        of_store = [k for k, drive in enumerate(drives) if drive[0] == number]
        for out in filter(len, (of_store[fold::FOLDS] for fold in range(FOLDS))):
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
        arguments.write.write_text(as_json(everything, len(drives)), encoding="utf-8")


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
