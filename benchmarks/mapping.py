"""One core from a scan to its evidence, and from a file to the store, beside Patchwork++'s ground segmentation alone.

    python -m benchmarks.mapping --kitti KITTI_ROOT

The promises: a scan in memory to evidence in at most 3 ms, several times faster than Patchwork++ (pip install
pypatchworkpp) needs for the ground of the same scans in the same run; with a grid of 256 cells beside the judged one at
most 2.5 times as long; a file to the store in at most 6 ms, written to the disk with fsync.  Everything takes turns
scan by scan, so that a noisy machine meets all alike.  Without KITTI drives the scans are made up: fewer points than
real ones and a simpler scene.
"""

import argparse
import itertools
import os
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.timing import medians, print_table
from envpred.build.grids import map_drive, mapper_of
from envpred.drives import Drive, find_drives
from envpred.mapping import evidence
from envpred.mapping.ground import RansacPlane
from envpred.mapping.mapper import MappingParameters
from tests.drives.synthetic import write_drive

SCAN_PROMISE, STORE_PROMISE = 3.0, 6.0  # milliseconds a frame
CONTEXT, CONTEXT_PROMISE = 256, 2.5  # cells of the wider grid, and how much longer both may take than the judged one
# Not measured here: seen elsewhere, one core each.
REFERENCE = [
    ("paper's reference code, scan to label grid", "1700 to 2600"),
    ("  of it the random field", "1250"),
    ("  of it the rays", "500"),
    ("Patchwork++ (C++), ground of a real scan", "8.9 to 15.5"),
]


class Mapping:
    """The steps of mapping some scans of a drive, each step on inputs that lie ready in memory."""

    def __init__(self, drive: Drive, frames: int) -> None:
        self.parameters = parameters = MappingParameters()
        self.drive = drive
        chosen = np.linspace(0, len(drive.frames) - 1, min(frames, len(drive.frames))).astype(int)
        mapper, spec = mapper_of(drive, parameters), parameters.grid
        assert mapper.origin is not None
        self.origin = mapper.origin
        self.poses = drive.poses[chosen]
        self.cells = spec.cell_of(self.poses[:, :3, 3], self.origin)
        self.sensors = self.poses @ mapper.sensor_to_body
        self.scans = [drive.scan(drive.frames[t]) for t in chosen]
        self.obstacles = [parameters.ground.obstacles(points, spec.reach) for points in self.scans]
        self.labels = [self.label(t) for t in range(len(self.scans))]
        self.mass = np.zeros((2, spec.cells, spec.cells), np.float32)

    def ground(self, t: int) -> None:
        """Obstacle points of scan `t`."""
        self.obstacles[t] = self.parameters.ground.obstacles(self.scans[t], self.parameters.grid.reach)

    def label(self, t: int) -> NDArray[np.uint8]:
        """Label grid of scan `t` from its obstacle points."""
        inputs = self.scans[t], self.obstacles[t], self.sensors[t], self.cells[t], self.origin
        return self.parameters.rays.label(*inputs, self.parameters.grid)

    def fuse(self, t: int) -> None:
        """Evidence from the label grid of scan `t` and the mass before, one cell further."""
        self.mass = evidence.step(self.mass, self.labels[t], np.array([1, 0]), self.parameters.evidence)

    def whole(self, context: int | None = None) -> Callable[[int], object]:
        """Scan `t` to evidence, with a wider grid of `context` cells beside the judged one or without."""
        mapper = mapper_of(self.drive, self.parameters, context)
        time = itertools.count()
        return lambda t: mapper.step(self.scans[t], self.poses[t], mapper.period * next(time))


def patchwork(mapping: Mapping) -> Callable[[int], object] | None:
    """Patchwork++'s ground segmentation of scan `t`, with its own defaults, where it is installed."""
    try:
        import pypatchworkpp
    except ImportError:
        return None
    parameters = pypatchworkpp.Parameters()
    parameters.verbose = False
    peer = pypatchworkpp.patchworkpp(parameters)
    return lambda t: peer.estimateGround(mapping.scans[t])


def in_turn(work: Callable[[int], object], scans: int) -> Callable[[], object]:
    """`work` on the next scan, round and round."""
    turn = itertools.cycle(range(scans))
    return lambda: work(next(turn))


def time_scans(drive: Drive, frames: int, rounds: int) -> None:
    """Print medians of the steps in memory."""
    mapping = Mapping(drive, frames)
    plane = RansacPlane()
    work: dict[str, Callable[[int], object]] = {
        "scan to evidence": mapping.whole(),
        "  ground: random field": mapping.ground,
        "  label grid": mapping.label,
        "  evidence": mapping.fuse,
        "ground by RANSAC instead": lambda t: plane.obstacles(mapping.scans[t], mapping.parameters.grid.reach),
    }
    peer = patchwork(mapping)
    if peer:
        work["Patchwork++, ground alone"] = peer
    count = len(mapping.scans)
    seconds = medians({name: in_turn(step, count) for name, step in work.items()}, rounds * count)
    ours = seconds["scan to evidence"]
    points = int(np.median([len(points) for points in mapping.scans]))
    print(f"\n{drive.name}: {count} scans of {points:,} points (median), {rounds} rounds")
    rows = [(name, f"{1e3 * taken:.2f}", f"{taken / ours:.2f}") for name, taken in seconds.items()]
    print_table(("one core, medians", "ms a scan", "x ours"), rows)
    print(f"promise: scan to evidence <= {SCAN_PROMISE} ms: {'kept' if 1e3 * ours <= SCAN_PROMISE else 'MISSED'}")
    # In turns of its own: the wider grid leaves nothing of the others in the cache.
    pair = {name: in_turn(mapping.whole(cells), count) for name, cells in (("judged", None), ("both", CONTEXT))}
    wider = medians(pair, rounds * count)
    ratio = wider["both"] / wider["judged"]
    print(
        f"with {CONTEXT} cells beside the judged grid: {1e3 * wider['both']:.2f} ms, {ratio:.2f} x; "
        f"promise <= {CONTEXT_PROMISE} x: {'kept' if ratio <= CONTEXT_PROMISE else 'MISSED'}"
    )
    if not peer:
        print("Patchwork++ is not installed: pip install 'envpred[bench]'")


def time_store(drive: Drive, rounds: int) -> None:
    """Print the median time of mapping the whole drive from its files into a store."""
    taken = []
    for _ in range(rounds + 1):  # the first one warms the disk cache
        with tempfile.TemporaryDirectory() as folder:
            start = time.perf_counter()
            frames = map_drive(drive, Path(folder), MappingParameters(), {"mapping": "0" * 16})
            taken.append((time.perf_counter() - start) / frames)
    milliseconds = 1e3 * statistics.median(taken[1:])
    verdict = "kept" if milliseconds <= STORE_PROMISE else "MISSED"
    print(f"{drive.name}: file to store {milliseconds:.2f} ms a frame; promise <= {STORE_PROMISE} ms: {verdict}")


def main() -> None:
    """Time every drive that was given."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kitti", type=Path, help="folder with KITTI raw drives; left out: made-up scans")
    parser.add_argument("--scans", type=int, default=40, help="scans of each drive that are timed in memory")
    parser.add_argument("--rounds", type=int, default=5, help="times each scan is mapped, and each drive is stored")
    arguments = parser.parse_args()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    with tempfile.TemporaryDirectory() as folder:
        made_up = arguments.kitti is None
        drives = find_drives(write_drive(Path(folder), frames=60, azimuths=14000) if made_up else arguments.kitti)
        for drive in drives:
            time_scans(drive, arguments.scans, arguments.rounds)
            time_store(drive, arguments.rounds)
    print("\nfor comparison, measured elsewhere on other machines")
    print_table(("one core", "ms a scan"), REFERENCE)


if __name__ == "__main__":
    main()
