"""Simulated scans a second (rays, labels, boxes, files), on one core and on two at once.  Promise: at least 20 and 30.

python -m benchmarks.simulate [--scans 150]
"""

import argparse
import multiprocessing
import tempfile
import time
from pathlib import Path

import numpy as np

from envpred.simulate.lidar import HDL64E
from envpred.simulate.run import builtin_recording
from envpred.simulate.scene import build
from envpred.simulate.traffic import Recording
from envpred.simulate.writer import write_drive

ONE, TWO = 20.0, 30.0  # scans a second that are promised


def drive(network: int, scans: int) -> tuple[float, float, float, float]:
    """Seconds that building and writing a drive take, the processor's and by the clock, and points a scan."""
    recording = Recording.load(builtin_recording())
    start = time.process_time()
    scene = build(recording, network, recording.motions(network), scans, 7.0, np.random.default_rng(network))
    built = time.process_time() - start
    with tempfile.TemporaryDirectory() as folder:
        start, by_clock = time.process_time(), time.perf_counter()
        counts = list(write_drive(Path(folder) / "drive", scene, HDL64E(), 1, np.random.default_rng(0)))
        return built, time.process_time() - start, time.perf_counter() - by_clock, float(np.mean(counts))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scans", type=int, default=150, help="scans in each town (a drive by default has 150)")
    scans = parser.parse_args().scans
    recording = Recording.load(builtin_recording())
    names = [network.name for network in recording.networks]
    able = [k for k, n in enumerate(recording.networks) if n.longest(recording.interval) >= scans]
    print(f"{'town':20}{'build (s)':>10}{'scans/s':>9}{'of promise':>12}{'points a scan':>15}")
    rates = []
    for network in able:
        # Processor time of this process: what one core does, whatever else runs on the machine.
        built, seconds, _, points = drive(network, scans)
        rates.append(scans / seconds)
        print(f"{names[network]:20}{built:10.1f}{rates[-1]:9.1f}{rates[-1] / ONE:11.2f}x{points:15.0f}")
    print(f"{'median':20}{'':10}{np.median(rates):9.1f}{np.median(rates) / ONE:11.2f}x")
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        found = pool.starmap(drive, [(network, scans) for network in able[:2]])
    together = sum(scans / clock for _, _, clock, _ in found)
    print(f"{'two at once, clock':20}{'':10}{together:9.1f}{together / TWO:11.2f}x")


if __name__ == "__main__":
    main()
