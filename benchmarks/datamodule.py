"""A data module over 40,000 frames: how soon it starts, how much memory it takes, and how fast windows come.

    python -m benchmarks.datamodule                       # a store is made up for it: files with holes, gone afterwards
    python -m benchmarks.datamodule --store grids/        # or one of yours

The promise: ready in less than 2 s, less than 1 GiB of memory in the process, and a window at least 20 times faster
than a training step, here PredNet's with channels (2, 16, 32, 64) and with the paper's, batch 1, stage t+5, forward
and backward.  Files with holes are read from memory; grids that are not cached yet come at the disk's speed, 1.3 MB a
window of 20 frames.
"""

import argparse
import math
import statistics
import tempfile
import time
import zlib
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.timing import peak_memory
from envpred.datamodules import GridDataModule
from envpred.mapping.geometry import Body
from envpred.networks.prednet import PredNet
from envpred.store import FORMAT, MANIFEST, Store
from envpred.store.files import write_json

DRIVES, FRAMES, CELLS, WINDOWS = 130, 310, 128, 500
NETWORKS = {"small PredNet": (2, 16, 32, 64), "paper's PredNet": (2, 48, 96, 192)}
START_PROMISE, MEMORY_PROMISE, RATIO_PROMISE = 2.0, 1.0, 20.0


def write_sparse_store(folder: Path, drives: int = DRIVES, frames: int = FRAMES, cells: int = CELLS) -> None:
    """A store of grids whose arrays are holes (zeros) and take no room on the disk."""
    key = Store(folder).claim("mapping", {"cells": cells})
    arrays: dict[str, tuple[np.dtype[Any], tuple[int, ...]]] = {
        "label": (np.dtype("u1"), (frames, cells, cells)),
        "evidence": (np.dtype("<f2"), (frames, 2, cells, cells)),
        "centre_cell": (np.dtype("<i4"), (frames, 2)),
        "pose": (np.dtype("<f8"), (frames, 4, 4)),
        "time": (np.dtype("<f8"), (frames,)),
    }
    checksums = {name: zlib.crc32(bytes(dtype.itemsize * math.prod(shape))) for name, (dtype, shape) in arrays.items()}
    for number in range(drives):
        drive = folder / f"drive_{number:04d}"
        drive.mkdir()
        entries = {}
        for name, (dtype, shape) in arrays.items():
            with (drive / f"{name}.npy").open("wb") as file:
                header = {"descr": dtype.str, "fortran_order": False, "shape": shape}
                np.lib.format.write_array_header_1_0(file, header)
                file.truncate(file.tell() + dtype.itemsize * int(np.prod(shape)))
            entries[name] = {
                "file": f"{name}.npy",
                "dtype": dtype.str,
                "shape": list(shape),
                "checksum": checksums[name],
                "group": "mapping",
            }
        manifest = {
            "format": FORMAT,
            "drive": drive.name,
            "frames": list(range(frames)),
            "stretches": [(0, frames)],
            "lattice": {"origin": [0.0, 0.0], "resolution": 1 / 3, "cells": cells, "context": None},
            "period": 0.1,
            "sensor": np.eye(4).tolist(),
            "body": asdict(Body()),
            "groups": {"mapping": key},
            "arrays": entries,
        }
        write_json(drive / MANIFEST, manifest)


def started(store: Path) -> tuple[GridDataModule, float]:
    """The data module, ready to fit, and the seconds that took."""
    start = time.perf_counter()
    data = GridDataModule(store, samples=WINDOWS)
    data.setup("fit")
    return data, time.perf_counter() - start


def draw(data: GridDataModule) -> float:
    """Median seconds a training window takes, over one epoch."""
    seconds, before = [], time.perf_counter()
    for _ in data.train_dataloader():
        now = time.perf_counter()
        seconds.append(now - before)
        before = now
    return statistics.median(seconds)


def training_step(channels: tuple[int, ...], repeats: int) -> float:
    """Median seconds of forward and backward at batch 1, after one that does not count."""
    network, frames, seconds = PredNet(channels), torch.rand(1, 20, channels[0], CELLS, CELLS), []
    for _ in range(repeats + 1):
        start = time.perf_counter()
        loss = (network(frames, given=5) - frames)[:, 1:].abs().mean()
        loss.backward()
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds[1:])


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--store", type=Path, help="a store of yours instead of the one made up")
    parser.add_argument("--threads", type=int, default=2, help="threads of the training step")
    parser.add_argument("--repeats", type=int, default=3, help="training steps that count")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    with tempfile.TemporaryDirectory() as folder:
        if options.store is None:
            write_sparse_store(Path(folder) / "grids")
        imported = peak_memory()
        store = options.store or Path(folder) / "grids"
        print(f"arrays compared with their checksums, the first time alone: {started(store)[1]:.2f} s")
        data, seconds = started(store)
        frames = sum(s.stop - s.start for part in data.selected.values() for s in part)
        print(f"frames {frames}, training windows {len(data.datasets['train'])}")
        print(f"ready after {seconds:.2f} s (promised: below {START_PROMISE:.0f})")
        window = draw(data)
        print(
            f"{WINDOWS} windows: {1e3 * window:.2f} ms each, {1 / window:.0f} windows/s (batch 1, no worker processes)"
        )
        print(
            f"peak memory {peak_memory():.2f} GiB, {imported:.2f} of it libraries "
            f"(promised: below {MEMORY_PROMISE:.0f})"
        )
    for name, channels in NETWORKS.items():
        step = training_step(channels, options.repeats)
        print(
            f"{name} {channels}: training step {step:.2f} s on {options.threads} threads, "
            f"{step / window:.0f} x a window (promised: {RATIO_PROMISE:.0f})"
        )


if __name__ == "__main__":
    main()
