"""The particle filter's cost per frame, on the label grids of a scene with cars, walls and a moving ego.

    python -m benchmarks.particles --threads 2
    python -m benchmarks.particles --threads 2 --plot cost.png

The promises: 2e5 + 2e4 particles on 128 x 128 cells in at most 16 ms a frame on two CPU threads (the paper's code takes
7610 ms, a port to C++ with OpenMP 65 ms); with the 15-step particle forecast and everything before it, 40 ms from scan
to store.  Where there is a GPU, 2e6 + 2e5 particles on 1200 x 1200 cells in at most 5 ms (Nuss et al.: 50 ms on a GTX
980), measured with events, with the count of kernel launches.  The plot shows the cost against the number of particles.
"""

import argparse
import statistics
from dataclasses import replace
from pathlib import Path

import matplotlib
import torch
from torch import Tensor

from benchmarks.timing import medians, print_table
from envpred.mapping.dogma import DogmaParameters, confident, is_moving, to_byte
from envpred.mapping.geometry import GridSpec
from envpred.mapping.particle_forecast import forecast
from envpred.mapping.particle_state import GROUND, ParticleFilterParameters, initial_state
from envpred.mapping.particles import step

WARM_UP, SHIFT = 10, (1, 0)  # frames until the particles have settled; cells that the ego drives a frame


def scene(grid: GridSpec, frames: int) -> Tensor:
    """Measurement masses (T, 2, H, W): every 43 m two walls, a standing and a moving car in free space."""
    position = torch.arange(grid.cells) * grid.resolution
    masses = []
    for t in range(frames):
        east = (position + SHIFT[0] * t * grid.resolution)[:, None] % 42.7
        north = position[None, :] % 42.7
        wall = ((north - 8).abs() < 0.4) | ((north - 30).abs() < 0.4)
        standing = ((east - 12).abs() < 2.2) & ((north - 12).abs() < 1)
        moving = (((east - 20 - 0.8 * t) % 42.7 - 2.2).abs() < 2.2) & ((north - 20).abs() < 1)
        occupied = wall | standing | moving
        unknown = (north < 7.5) | (north > 30.5)
        masses.append(0.95 * torch.stack((occupied, ~occupied & ~unknown)).float())
    return torch.stack(masses)


class Drive:
    """The filter at work on `scene`, one frame a call."""

    def __init__(self, parameters: ParticleFilterParameters, grid: GridSpec, frames: int, device: str) -> None:
        self.parameters, self.grid = parameters, grid
        self.measured = scene(grid, WARM_UP + frames).to(device)
        self.generator = torch.Generator(device).manual_seed(0)
        self.state, self.t = initial_state(parameters, grid, device), 0
        for _ in range(WARM_UP):
            self.step()

    @torch.inference_mode()
    def step(self) -> None:
        seen = self.measured[self.t % len(self.measured)]
        self.state, self.dogma = step(self.state, seen, SHIFT, self.parameters, self.grid, self.generator)
        self.t += 1

    @torch.inference_mode()
    def forecast(self) -> None:
        dogma = confident(self.dogma, DogmaParameters())
        moving = is_moving(dogma.velocity, dogma.covariance)
        to_byte(forecast(self.state, moving, self.parameters, self.grid, self.generator))


def on_cpu(repeats: int) -> None:
    """Filter and forecast at the published size, both frames of reference, taking turns."""
    drives = {p.frame: Drive(p, GridSpec(), repeats + 1, "cpu") for p in (ParticleFilterParameters(), GROUND)}
    work = {
        f"{part}, {frame}": getattr(drive, part) for frame, drive in drives.items() for part in ("step", "forecast")
    }
    seconds = medians(work, repeats)
    promises = {"step": 16.0}
    rows = [
        (name, f"{1e3 * s:.1f}", f"{promises[part]:.0f}" if (part := name.split(",")[0]) in promises else "")
        for name, s in seconds.items()
    ]
    print_table(("2e5 + 2e4 particles, 128 x 128 cells", "ms a frame", "promised"), rows)


def on_gpu(repeats: int) -> None:
    """The size of Nuss et al., between events on the GPU's own clock."""
    drive = Drive(replace(GROUND, persistent=2_000_000, births=200_000), GridSpec(cells=1200), 20, "cuda")
    milliseconds = []
    for _ in range(repeats):
        start, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))  # type: ignore[no-untyped-call]
        start.record()
        drive.step()
        end.record()
        torch.cuda.synchronize()
        milliseconds.append(start.elapsed_time(end))
    with torch.profiler.profile(activities=[torch.profiler.ProfilerActivity.CUDA]) as profile:
        drive.step()
        torch.cuda.synchronize()
    launches = sum(event.count for event in profile.key_averages() if not event.key.startswith("Mem"))
    row = (torch.cuda.get_device_name(), f"{statistics.median(milliseconds):.2f}", "5", str(launches))
    print_table(("2e6 + 2e5 particles, 1200 x 1200 cells", "ms a frame", "promised", "kernels"), [row])


def against_particles(device: str, largest: int) -> list[tuple[int, float]]:
    """(particles, seconds a frame) from 1e4 to `largest` on 128 x 128 cells."""
    finish = torch.cuda.synchronize if device == "cuda" else lambda: None
    costs = []
    for count in (n for n in (10_000, 30_000, 100_000, 300_000, 1_000_000, 3_000_000, 10_000_000) if n <= largest):
        drive = Drive(replace(GROUND, persistent=count, births=count // 10), GridSpec(), 20, device)
        repeats = max(3, min(20, 6_000_000 // count))
        costs.append((count, medians({"step": drive.step}, repeats, finish)["step"]))
    return costs


def plot(costs: dict[str, list[tuple[int, float]]], file: Path) -> None:
    """Milliseconds a frame against the number of particles, one line a device."""
    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(5, 3.5), layout="constrained")
    for device, points in costs.items():
        axes.loglog([n for n, _ in points], [1e3 * s for _, s in points], "o-", label=device)
    axes.set(xlabel="persistent particles", ylabel="ms a frame", title="Particle filter, 128 x 128 cells")
    axes.grid(visible=True, which="both", alpha=0.3)
    axes.legend()
    figure.savefig(file)


def main() -> None:
    """Print the tables that the machine allows."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=50)
    parser.add_argument("--largest", type=int, default=10_000_000, help="most particles of the curve")
    parser.add_argument("--plot", type=Path, help="draw the cost against the number of particles into this file")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    on_cpu(options.repeats)
    devices = {f"CPU, {options.threads} threads": "cpu"}
    if torch.cuda.is_available():
        print()
        on_gpu(options.repeats)
        devices[torch.cuda.get_device_name()] = "cuda"
    if options.plot:
        costs = {name: against_particles(device, options.largest) for name, device in devices.items()}
        plot(costs, options.plot)
        for name, points in costs.items():
            print()
            print_table((name, "ms a frame"), [(f"{n:.0e}", f"{1e3 * s:.1f}") for n, s in points])


if __name__ == "__main__":
    main()
