"""Kinds of cells of what came."""

import numpy as np
import torch

from envpred.datamodules import WindowBatch
from envpred.mapping.boxes import MOVES, STANDS
from envpred.mapping.geometry import EGO, FREE, OCCUPIED, UNKNOWN
from envpred.models.kinds import kinds_of
from tests.models.trainers import seen
from tests.results.scenes import window


def batch(cells: torch.Tensor) -> WindowBatch:
    """Two windows of 5 frames shown and the rest to come, the second of an ego at `cells` (T, 2)."""
    occupancy, centre_cell = window()
    grids = torch.from_numpy(np.stack([occupancy, occupancy])).float()
    centre = torch.stack([torch.from_numpy(centre_cell), cells[: len(centre_cell)]])
    label = torch.full_like(grids, FREE, dtype=torch.uint8)
    shown = seen(
        label=label[:, :5],
        occupancy=grids[:, :5],
        centre_cell=centre[:, :5],
        resolution=torch.full((2,), 1 / 3),
        period=torch.full((2,), 0.1),
    )
    future = {"occupancy": grids[:, 5:], "centre_cell": centre[:, 5:], "label": label[:, 5:]}
    return {"seen": shown, "future": future, "drive": ["a", "b"], "start": torch.zeros(2), "index": torch.arange(2)}  # type: ignore[typeddict-item]


def test_what_enters_by_hand() -> None:
    """Two cells to the east and one to the south of the last frame shown at the first horizon; then back."""
    cells = torch.tensor([[70, 80]] * 5 + [[72, 79]] + [[70, 80]] * 50)
    found = kinds_of(batch(cells))
    entering = found["entering"][1]
    assert entering[0, -2:].all()
    assert entering[0, :, 0].all()
    assert not entering[0, :-2, 1:].any()
    assert not entering[1:].any()
    assert found["moving"].shape == found["entering"].shape
    assert found["moving"][0].any()


def test_what_has_changed_by_hand() -> None:
    """At the same place in the world, as the ego moves on by two cells east and one south; both frames measured."""
    cells = torch.tensor([[70, 80]] * 5 + [[72, 79]] * 50)
    moved = batch(cells)
    assert moved["future"] is not None
    last, now = moved["seen"]["label"][1, -1], moved["future"]["label"][1]
    codes = [(before, after) for before in (UNKNOWN, OCCUPIED, FREE, EGO) for after in (UNKNOWN, OCCUPIED, FREE, EGO)]
    for place, (before, after) in enumerate(codes):
        last[40, 40 + place] = before
        now[:, 38, 41 + place] = after
    found = kinds_of(moved)
    judged = {"changed": {(OCCUPIED, FREE), (FREE, OCCUPIED)}, "static": {(OCCUPIED, OCCUPIED), (FREE, FREE)}}
    for kind, pairs in judged.items():
        row = found[kind][1, :, 38, 41 : 41 + len(codes)]  # type: ignore[literal-required]
        assert row.tolist() == [[pair in pairs for pair in codes]] * len(row), kind
    elsewhere = found["static"][1].clone()
    elsewhere[:, 38, 41 : 41 + len(codes)] = True
    assert (elsewhere == ~found["entering"][1]).all()
    assert not (found["changed"] & found["static"]).any()


def test_boxes_say_what_moves_where_there_are_any() -> None:
    """Three cells around a box that moves, and none around one that stands, or what labels alone take for moving."""
    tracked, compared = (batch(torch.tensor([[70, 80]] * 56)) for _ in range(2))
    assert tracked["future"] is not None
    boxes = torch.zeros_like(tracked["future"]["label"])
    boxes[1, 2, 30:32, 20] = MOVES
    boxes[1, 2, 50:54, 40] = STANDS
    tracked["future"]["moving"] = boxes
    found, without = kinds_of(tracked), kinds_of(compared)
    around = torch.zeros_like(found["moving"])
    around[1, 2, 27:35, 17:24] = True
    assert (found["moving"] == around).all()
    assert without["moving"].any()
    assert (found["static"] == without["static"] & ~around).all()
    assert (without["static"] & around).any()
    for kind in ("changed", "entering"):
        assert (found[kind] == without[kind]).all()
