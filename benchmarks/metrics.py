"""What all metrics add to the cost of forecasting test windows with a small PredNet.

    python benchmarks/metrics.py --windows 100 --threads 2

The promise: less than 25 % on top of the forecasts alone.  Forecast and metrics take turns window by window, so that
a noisy machine meets both alike.
"""

import argparse
import statistics
import time

import torch
from torch import Tensor

from envpred.mapping.geometry import FREE, OCCUPIED
from envpred.metrics.collection import forecast_metrics
from envpred.metrics.outcome import measured
from envpred.networks.prednet import PredNet

GIVEN, HORIZONS, CELLS = 5, 15, 128
PROMISE = 0.25


def drifting_masses(generator: torch.Generator) -> Tensor:
    """A window (1, 20, 2, 128, 128) of masses of evidence: blocks of occupied, free and unknown cells that drift."""
    coarse = torch.rand(1, 1, 20, 20, generator=generator)
    scene = torch.nn.functional.interpolate(coarse, scale_factor=8)
    frames = [scene[0, 0, t : t + CELLS, t : t + CELLS] for t in range(GIVEN + HORIZONS)]
    height = torch.stack(frames)[None]
    return torch.stack([0.95 * (height > 0.9), 0.95 * (height < 0.4)], dim=2)


def pignistic(mass: Tensor) -> Tensor:
    """Probability of occupied (B, T, H, W) of masses (B, T, 2, H, W)."""
    return 0.5 * mass[:, :, 0] + 0.5 * (1 - mass[:, :, 1])


def told(mass: Tensor) -> dict[str, Tensor]:
    """What the metrics are told of the frames to come beside their probability: labels, and the kinds of cells."""
    label = (mass[:, :, 0] > 0) * OCCUPIED + (mass[:, :, 1] > 0) * FREE
    last, label = label[:, GIVEN - 1 : GIVEN].byte(), label[:, GIVEN:].byte()
    both, same = measured(last) & measured(label), last == label
    kinds = {"changed": both & ~same, "static": both & same, "moving": both & ~same, "entering": ~measured(last) & same}
    return {"label": label, **kinds}


def main() -> None:
    """Print medians and the ratio."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--windows", type=int, default=100)
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    generator = torch.Generator().manual_seed(0)
    network = PredNet((2, 16, 32, 64)).eval()
    metrics = forecast_metrics(HORIZONS)
    forecasting: list[float] = []
    each: dict[str, list[float]] = {}
    warm_up = 2  # compilation and first allocations
    for window in range(-warm_up, arguments.windows):
        mass = drifting_masses(generator)
        start = time.perf_counter()
        with torch.inference_mode():
            forecast = pignistic(network(mass, given=GIVEN))[:, GIVEN:]
        forecasting.append(time.perf_counter() - start)
        probability, beside = pignistic(mass), told(mass)
        target, last, index = probability[:, GIVEN:], probability[:, GIVEN - 1], torch.tensor([window + warm_up])
        for name, metric in metrics.items(keep_base=True):
            start = time.perf_counter()
            metric.update(forecast, target, last, index, **beside)
            each.setdefault(str(name), []).append(time.perf_counter() - start)
    start = time.perf_counter()
    metrics.compute()
    closing = (time.perf_counter() - start) / arguments.windows
    forecast_time = statistics.median(forecasting[warm_up:])
    medians = {name: statistics.median(times[warm_up:]) for name, times in each.items()}
    total = sum(medians.values()) + closing
    print(
        f"{arguments.windows} windows of {HORIZONS} horizons, {CELLS} x {CELLS}, {arguments.threads} threads; medians"
    )
    print(f"{'forecast':20s} {forecast_time * 1e3:8.2f} ms a window")
    for name, seconds in sorted(medians.items(), key=lambda item: -item[1]):
        print(f"{name:20s} {seconds * 1e3:8.2f} ms")
    print(f"{'compute':20s} {closing * 1e3:8.2f} ms (once, shared out)")
    print(f"{'all metrics':20s} {total * 1e3:8.2f} ms")
    print(f"on top of the forecast: {total / forecast_time:.1%} (promise: < {PROMISE:.0%})")


if __name__ == "__main__":
    main()
