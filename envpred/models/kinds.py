"""Kinds of cells of what came after the frames shown, by which metrics tell errors apart."""

from typing import TypedDict

import numpy as np
import torch
from torch import Tensor

from envpred.datamodules import WindowBatch
from envpred.mapping.arrivals import moving_cells
from envpred.mapping.shift import shifted


class Kinds(TypedDict, total=False):
    """Cells (B, N, H, W) bool, as metrics are told them (see `envpred.metrics.windows.Judged`)."""

    moving: Tensor
    entering: Tensor


def kinds_of(batch: WindowBatch) -> Kinds:
    """Cells around what has moved within half a second, and those that the last grid shown does not cover."""
    seen, future = batch["seen"], batch["future"]
    assert future is not None  # only prediction goes without
    occupancy = torch.cat([seen["occupancy"], future["occupancy"]], 1).cpu().numpy()
    centre = torch.cat([seen["centre_cell"], future["centre_cell"]], 1).cpu().numpy()
    given, device = seen["occupancy"].shape[1], future["occupancy"].device
    moving, entering = [], []
    for b in range(len(occupancy)):
        resolution, period = float(seen["resolution"][b]), float(seen["period"][b])
        moving.append(moving_cells(occupancy[b], centre[b], given, resolution, period))
        known = np.zeros(occupancy.shape[2:], np.bool_)
        entering.append(np.stack([shifted(known, at - centre[b, given - 1], fill=True) for at in centre[b, given:]]))
    return {
        "moving": torch.from_numpy(np.stack(moving)).to(device),
        "entering": torch.from_numpy(np.stack(entering)).to(device),
    }
