"""How well the particle filter's velocities and its moving/standing decision agree with boxes of tracked objects.

    python -m benchmarks.velocity_truth 2011_09_26_drive_0005_sync --view 80 --particles 20000 200000 2000000

Works on drives in KITTI raw's layout with a `tracklet_labels.xml`, real or simulated.  Truth is the motion of the
boxes' centres in the world (central differences); a cell's truth is that of the box it lies in.
"""

import argparse
import itertools
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from benchmarks.timing import print_table
from envpred.build.grids import mapped, mapper_of
from envpred.drives.drive import Drive
from envpred.drives.kitti import KittiDrive
from envpred.errors import UserError
from envpred.mapping import evidence
from envpred.mapping.dogma import Dogma, DogmaParameters, is_moving, run
from envpred.mapping.geometry import OCCUPIED, FloatArray, GridSpec, heading_of, transform
from envpred.mapping.mapper import MappingParameters
from envpred.mapping.particle_state import GROUND, ParticleFilterParameters
from envpred.simulate.writer import TRUE_POSES

MOVING = 1.0  # m/s: what an object must do to count as moving
FASTEST = 12.0  # m/s: the promise is about movers up to here
IN_VIEW = 10  # frames that a cell's object must have been in view
SETTINGS = {
    "ground": GROUND,
    "ground, numbers of the paper": ParticleFilterParameters(frame="ground"),
    "ego, numbers of the paper": ParticleFilterParameters(),
}


@dataclass(frozen=True)
class Box:
    """One object at one frame: centre (2,) and velocity (2,) in the world, heading, length, width."""

    centre: FloatArray
    heading: float
    length: float
    width: float
    velocity: FloatArray
    track: int


@dataclass(frozen=True)
class Grids:
    """A drive's label grids (T, H, W), centre cells (T, 2) and the lattice's origin (2,)."""

    labels: NDArray[np.uint8]
    centre_cell: NDArray[np.int32]
    origin: FloatArray


@dataclass(frozen=True)
class Truth:
    """Per cell: the number of the box that covers it (-1: none), its velocity (m/s), for how many frames it has been in
    view, and whether an object there would have a box."""

    box: NDArray[np.int32]
    velocity: NDArray[np.float32]
    in_view: NDArray[np.int32]
    annotated: NDArray[np.bool_]


def read_boxes(drive: Drive) -> list[list[Box]]:
    """The boxes of every frame of `drive`."""
    if not drive.has_tracklets:
        raise UserError(f"{drive.name}: has no boxes of tracked objects; unpack the drive's tracklets there")
    to_world = {k: drive.pose(k) @ drive.sensor_to_body() for k in drive.frames}
    if isinstance(drive, KittiDrive) and (drive.folder / TRUE_POSES).exists():  # packets are late
        places = np.loadtxt(drive.folder / TRUE_POSES).reshape(-1, 3, 4)
        start = np.mean([to_world[k][:3, 3] - places[k, :, 3] for k in drive.frames], axis=0)
        for k in drive.frames:
            to_world[k] = np.vstack([places[k] + np.column_stack([np.zeros((3, 3)), start]), [0, 0, 0, 1]])
    position = {k: n for n, k in enumerate(drive.frames)}
    boxes: list[list[Box]] = [[] for _ in drive.frames]
    for number, track in enumerate(drive.tracklets()):
        placed = {}
        for k, (x, y, z, yaw) in zip(track.frames, track.poses, strict=True):
            if k in to_world:
                centre = transform(np.array([[x, y, z]]), to_world[k])[0, :2]
                ahead = to_world[k][:2, :2] @ (np.cos(yaw), np.sin(yaw))
                placed[k] = centre, float(np.arctan2(ahead[1], ahead[0]))
        for k, (centre, heading) in placed.items():
            before, after = max(k - 2, min(placed)), min(k + 2, max(placed))
            if before < after and before in placed and after in placed:
                velocity = (placed[after][0] - placed[before][0]) / (drive.time(after) - drive.time(before))
                boxes[position[k]].append(Box(centre, heading, *track.size[:2], velocity, number))
    return boxes


def map_drive(drive: Drive, grid: GridSpec) -> Grids:
    """The label grids of `drive`."""
    mapper = mapper_of(drive, MappingParameters(grid))
    assert mapper.origin is not None
    frames = list(mapped(drive, mapper))
    labels, centre_cell = (np.stack(values) for values in zip(*((f.label, f.centre_cell) for f in frames), strict=True))
    return Grids(labels, centre_cell, mapper.origin)


def rasterise(
    boxes: list[list[Box]], grids: Grids, grid: GridSpec, poses: FloatArray, view: float = 360.0
) -> Iterator[Truth]:
    """What the boxes say about the cells of every frame; `view`: degrees about the ego's heading that have boxes."""
    seen: dict[int, int] = {}
    offset = np.arange(grid.cells) - grid.half
    for t, frame in enumerate(boxes):
        east = (grids.centre_cell[t, 0] + offset)[:, None] * grid.resolution + grids.origin[0]
        north = (grids.centre_cell[t, 1] + offset)[None, :] * grid.resolution + grids.origin[1]
        bearing = np.arctan2(north - poses[t, 1, 3], east - poses[t, 0, 3]) - heading_of(poses[t])
        annotated = np.cos(bearing) >= np.cos(np.radians(view / 2))
        box = np.full((grid.cells, grid.cells), -1, np.int32)
        velocity = np.zeros((2, grid.cells, grid.cells), np.float32)
        in_view = np.zeros((grid.cells, grid.cells), np.int32)
        for b in frame:
            cos, sin, x, y = np.cos(b.heading), np.sin(b.heading), east - b.centre[0], north - b.centre[1]
            reach = grid.resolution / 2  # the cell that holds the returns of a side may have its centre outside
            inside = (abs(cos * x + sin * y) <= b.length / 2 + reach) & (abs(cos * y - sin * x) <= b.width / 2 + reach)
            hit = bool((inside & (grids.labels[t] == OCCUPIED)).any())
            seen[b.track] = seen.get(b.track, 0) + 1 if hit else 0
            box[inside], in_view[inside] = b.track, seen[b.track]
            velocity[:, inside] = b.velocity[:, None]
        yield Truth(box, velocity, in_view, annotated)


@dataclass(frozen=True)
class Score:
    """Of moving objects' cells: track, true and found velocity (2, N); of all occupied: decided and true motion."""

    track: NDArray[np.int32]
    true: NDArray[np.float32]
    found: NDArray[np.float32]
    decided: NDArray[np.bool_]
    moves: NDArray[np.bool_]

    def row(self, of: NDArray[np.bool_] | slice = slice(None)) -> tuple[str, ...]:
        """Cells, median true and found speed, median |velocity error| (m/s), median heading error (degrees)."""
        true, found = self.true[:, of], self.found[:, of]
        angle = np.arctan2(found[0] * true[1] - found[1] * true[0], (found * true).sum(0))
        medians = (
            np.median(values)
            for values in (np.hypot(*true), np.hypot(*found), np.hypot(*(found - true)), np.degrees(abs(angle)))
        )
        return (str(true.shape[1]), *(f"{value:.2f}" for value in medians))

    def decision(self) -> tuple[str, str]:
        """Precision and recall of "this cell moves"."""
        hits = (self.decided & self.moves).sum()
        return f"{hits / max(self.decided.sum(), 1):.2f}", f"{hits / max(self.moves.sum(), 1):.2f}"


def score(dogma: Dogma, truth: list[Truth], grids: Grids, ego_velocity: FloatArray, tau: float) -> Score:
    """Compare the filter's output with `truth`; velocities are relative to `ego_velocity` (T, 2)."""
    moving = is_moving(torch.from_numpy(dogma.velocity), torch.from_numpy(dogma.covariance), tau).numpy()
    parts = []
    for t in range(IN_VIEW, len(truth)):
        now = truth[t]
        known = (grids.labels[t] == OCCUPIED) & (dogma.covariance[t, 0] > 0)
        actual = now.velocity - ego_velocity[t][:, None, None]
        speed = np.hypot(*now.velocity)
        chosen = known & (speed > MOVING) & (speed <= FASTEST) & (now.in_view >= IN_VIEW)
        found = dogma.velocity[t].astype(np.float32)
        judged = known & now.annotated
        parts.append(
            (
                now.box[chosen],
                actual[:, chosen],
                found[:, chosen],
                moving[t][judged],
                np.hypot(*actual)[judged] > MOVING,
            )
        )
    return Score(*(np.concatenate(part, axis=-1) for part in zip(*parts, strict=True)))


def main() -> None:
    """Print one row per drive, frame of reference and particle count."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument(
        "drive", type=Path, nargs="+", help="folder <date>_drive_<number>_sync with tracklet_labels.xml"
    )
    parser.add_argument("--particles", type=int, nargs="+", default=[200_000])
    parser.add_argument("--frames", nargs="+", choices=SETTINGS, default=list(SETTINGS))
    parser.add_argument(
        "--view", type=float, default=360.0, help="degrees ahead in which objects have boxes (KITTI: 80)"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tracks", action="store_true", help="also one row per object")
    options = parser.parse_args()
    grid = GridSpec()
    rows: list[tuple[str, ...]] = []
    everything: dict[tuple[str, int], list[Score]] = {}
    for folder in options.drive:
        drive = KittiDrive(folder)
        grids = map_drive(drive, grid)
        truth = list(rasterise(read_boxes(drive), grids, grid, drive.poses, options.view))
        times = [drive.time(k) for k in drive.frames]
        ego_velocity = np.stack([np.gradient(drive.poses[:, axis, 3], times) for axis in (0, 1)], 1)
        measured = evidence.measured(grids.labels)
        for name, count in itertools.product(options.frames, options.particles):
            parameters = DogmaParameters(replace(SETTINGS[name], persistent=count, births=count // 10))
            dogma = run(measured, grids.centre_cell, parameters, grid, options.seed)
            relative_to = ego_velocity if parameters.filter.frame == "ego" else 0 * ego_velocity
            result = score(dogma, truth, grids, relative_to, parameters.tau)
            everything.setdefault((name, count), []).append(result)
            rows.append((drive.name, name, f"{count:.0e}", *result.row(), *result.decision()))
            if options.tracks:
                for track in np.unique(result.track):
                    rows.append((f"  object {track}", "", "", *result.row(result.track == track), "", ""))
    if len(options.drive) > 1:
        for (name, count), scores in everything.items():
            merged = Score(
                *(np.concatenate([getattr(s, field.name) for s in scores], axis=-1) for field in fields(Score))
            )
            rows.append(("all", name, f"{count:.0e}", *merged.row(), *merged.decision()))
    header = ("drive", "frame", "particles", "cells", "true m/s", "found m/s", "|error| m/s", "heading deg")
    print_table((*header, "precision", "recall"), rows)


if __name__ == "__main__":
    main()
