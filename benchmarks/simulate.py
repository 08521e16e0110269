"""Simulated scans a second on one core: rays, labels, boxes and files.  Promise: at least 10.

python benchmarks/simulate.py [--scans 150]
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from envpred.simulate.lidar import HDL64E
from envpred.simulate.run import builtin_recording
from envpred.simulate.scene import build
from envpred.simulate.traffic import Recording
from envpred.simulate.writer import write_drive

PROMISE = 10.0  # scans a second and core


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scans", type=int, default=150, help="scans in each town (a drive by default has 150)")
    scans = parser.parse_args().scans
    recording = Recording.load(builtin_recording())
    print(f"{'town':14}{'build (s)':>10}{'scans/s':>9}{'of promise':>12}{'points a scan':>15}")
    for network, town in enumerate(recording.networks):
        start = time.process_time()
        scene = build(recording, network, recording.motions(network), scans, 7.0, np.random.default_rng(network))
        built = time.process_time() - start
        with tempfile.TemporaryDirectory() as folder:
            # Processor time of this process: what one core does, whatever else runs on the machine.
            start = time.process_time()
            counts = list(write_drive(Path(folder) / "drive", scene, HDL64E(), 1, np.random.default_rng(0)))
            rate = scans / (time.process_time() - start)
        print(f"{town.name:14}{built:10.1f}{rate:9.1f}{rate / PROMISE:11.1f}x{np.mean(counts):15.0f}")


if __name__ == "__main__":
    main()
