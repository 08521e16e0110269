"""Kinds of cells of what came after the frames shown, by which metrics tell errors apart."""

from typing import TypedDict

import numpy as np
import torch
from torch import Tensor

from envpred.datamodules import WindowBatch
from envpred.mapping.arrivals import around, moving_cells
from envpred.mapping.boxes import MOVES
from envpred.mapping.shift import shifted_tensor
from envpred.metrics.outcome import measured

BEYOND = 255  # no code of a label grid: a cell that the last frame shown does not cover


class Kinds(TypedDict, total=False):
    """Cells (B, N, H, W) bool, as metrics are told them (see `envpred.metrics.windows.Judged`)."""

    changed: Tensor
    static: Tensor
    moving: Tensor
    entering: Tensor


def kinds_of(batch: WindowBatch) -> Kinds:
    """Cells that have changed or not since the last frame shown, those around what moves, and those that it lacks.

    Cells are compared at the same place in the world: the ego's motion alone changes nothing.  What moves is what boxes
    of tracked objects say where the batch has them, and static cells then lie apart from it; else what has moved into a
    place that was free.
    """
    seen, future = batch["seen"], batch["future"]
    assert future is not None  # only prediction goes without
    occupancy = torch.cat([seen["occupancy"], future["occupancy"]], 1).cpu().numpy()
    centre = torch.cat([seen["centre_cell"], future["centre_cell"]], 1).cpu().numpy()
    given, boxes = seen["occupancy"].shape[1], future.get("moving")
    moving, before = [], []
    for b in range(len(occupancy)):
        resolution, period = float(seen["resolution"][b]), float(seen["period"][b])
        if boxes is None:
            moving.append(moving_cells(occupancy[b], centre[b], given, resolution, period))
        else:
            moving.append(around(boxes[b].cpu().numpy() == MOVES, resolution))
        shifts = centre[b, given:] - centre[b, given - 1]
        before.append(torch.stack([shifted_tensor(seen["label"][b, -1], shift, BEYOND) for shift in shifts]))
    was, now = torch.stack(before), future["label"]
    both, same = measured(was) & measured(now), was == now
    moves = torch.from_numpy(np.stack(moving)).to(now.device)
    return {
        "changed": both & ~same,
        "static": both & same if boxes is None else both & same & ~moves,
        "moving": moves,
        "entering": was == BEYOND,
    }
