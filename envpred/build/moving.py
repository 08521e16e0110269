"""What moves, by the boxes of tracked objects that come with a drive: beside the grids of a drive that is stored."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from envpred.drives import Drive
from envpred.drives.tracklets import HIDDEN, Tracklet
from envpred.mapping.boxes import MOVES, SLOWEST, SPAN, STANDS, in_box, speeds
from envpred.mapping.geometry import FloatArray
from envpred.store import DriveWriter, StoredDrive

PARAMETERS = {"slowest": SLOWEST, "span": SPAN}  # of the group `moving`


class _Placed(NamedTuple):
    """A box in the world at one frame: centre (2,) in metres, heading, length and width, and whether it moves."""

    centre: FloatArray
    heading: float
    size: tuple[float, float]
    code: int


def add_moving(drive: Drive, store: Path, key: str, on_frame: Callable[[], None] = lambda: None) -> None:
    """Write the array `moving` of a `drive` that `store` holds: which cells lie in a box, one that stands or moves.

    Args:
        drive: that has tracklets.
        store: folder of the store.
        key: hash of the parameters, as `Store.claim` returns it.
        on_frame: called after each frame.

    Raises:
        UserError: if the tracklets cannot be read.
    """
    stored = StoredDrive(store / drive.name)
    boxes = _placed(stored, drive.tracklets())
    centre_cell, grid = np.array(stored.array("centre_cell")), stored.grid
    with DriveWriter(store, drive.name, "moving", key, {}) as out:
        writer = out.add("moving", np.uint8, (len(boxes), grid.cells, grid.cells))
        for cell, seen in zip(centre_cell, boxes, strict=True):
            moving = np.zeros((grid.cells, grid.cells), np.uint8)
            for box in sorted(seen, key=lambda box: box.code):  # where boxes overlap, what moves is told
                moving[in_box(box.centre, box.heading, box.size, cell, stored.origin, grid)] = box.code
            writer.append(moving)
            on_frame()


def _placed(stored: StoredDrive, tracklets: list[Tracklet]) -> list[list[_Placed]]:
    """The boxes of every stored frame that are not hidden in it: there cells say nothing of them."""
    to_world = np.array(stored.array("pose")) @ stored.sensor_to_body
    time = np.array(stored.array("time"))
    position = {k: t for t, k in enumerate(stored.frames)}
    placed: list[list[_Placed]] = [[] for _ in stored.frames]
    for track in tracklets:
        told = [(position[k], n) for n, k in enumerate(track.frames) if k in position]
        if not told:
            continue
        t, n = np.array(told).T
        x, y, z, yaw = np.array(track.poses)[n].T
        world = to_world[t]
        centre = np.einsum("nij,jn->ni", world[:, :2, :3], np.stack([x, y, z])) + world[:, :2, 3]
        ahead = np.einsum("nij,jn->ni", world[:, :2, :2], np.stack([np.cos(yaw), np.sin(yaw)]))
        heading = np.arctan2(ahead[:, 1], ahead[:, 0])
        codes = np.where(speeds(centre, time[t]) > SLOWEST, MOVES, STANDS)
        for k, (frame, pose) in enumerate(told):
            if track.occlusion[pose] != HIDDEN:
                placed[frame].append(_Placed(centre[k], float(heading[k]), track.size[:2], int(codes[k])))
    return placed
