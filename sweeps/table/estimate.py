"""How long a run will take: a training step of its network is timed here and now, and multiplied."""

import math
import time
from collections.abc import Mapping
from functools import cache
from typing import Any

import torch

from envpred.datamodules.variants import variant
from envpred.networks.prednet import PredNet

from ..runs.progress import epochs_of

# Seconds of a process that loads the libraries, of the pictures of a validation, and of a test's metrics and pictures.
START, PICTURES, TEST = 8.0, 2.0, 6.0
FORWARD = 0.4  # of a training step
ROLLED = 0.4  # seconds of a training step of the network on top of the rollout, or of a window's forecast
# Cells that a wide grid adds along the ego's way, and across it, to what is read.
ALONG, ACROSS = 48, 16


def seconds(config: Mapping[str, Any], cells: int, horizons: int, val_windows: int) -> float:
    """Estimated seconds of training and testing with the complete configuration `config`.

    Args:
        config: of the run.
        cells: along a side of the grids.
        horizons: frames that are forecast.
        val_windows: validation windows that there are; the test has about as many.
    """
    data, batch = config["data"], int(config["data"]["batch_size"])
    if "channels" in config["model"]["init_args"]:
        step, window = _prednet(data, config["model"]["init_args"], cells, horizons)
    else:
        step, window = ROLLED * batch, ROLLED
    windows = min(val_windows, int(data["val_windows"]))
    epoch = math.ceil(int(data["samples"]) / batch) * step + windows * window + PICTURES
    return 2.0 * START + epochs_of(config) * epoch + windows * window + TEST


def _prednet(data: Mapping[str, Any], model: Mapping[str, Any], cells: int, horizons: int) -> tuple[float, float]:
    """Seconds of a PredNet's training step, and of a window's forecast."""
    inputs = len(variant(data["variant"]).channels)
    batch = int(data["batch_size"])
    side = int(data["crop"] or cells)  # training may see squares of it alone
    step = _step((inputs, *model["channels"]), side, data["given"] + horizons, data["given"], batch)
    area, whole = float(side**2), float(cells**2)
    if model["context"]:
        area, whole = ((n + ALONG) * (n + ACROSS) for n in (side, cells))
    return step * area / side**2, FORWARD * step / batch * whole / side**2


def untrained(val_windows: int) -> float:
    """Estimated seconds of testing a baseline."""
    return START + TEST + 0.05 * val_windows


@cache
def _step(channels: tuple[int, ...], cells: int, length: int, given: int, batch: int) -> float:
    """Seconds of a training step, the better of two after one that loads."""
    network = PredNet(channels)
    frames = torch.rand(batch, length, channels[0], cells, cells)
    times = []
    for _ in range(3):
        start = time.perf_counter()
        (network(frames, given=given) - frames).abs().mean().backward()
        times.append(time.perf_counter() - start)
    return min(times[1:])
