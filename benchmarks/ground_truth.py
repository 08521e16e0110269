"""Scores ground segmentation and free space against the truth of simulated drives.

    python benchmarks/ground_truth.py [folder of simulated drives] [--every 2]

Protocol: a point is judged if it takes part in the method (|x|, |y| within reach, below the ceiling) and its class is
known.  Ground is road, parking, pavement, other ground and terrain (grass too).  Vegetation is left out, as leaves at
the foot of a hedge are neither; so is a point on the own vehicle.  Precision, recall and F1 are of *ground*, over all
judged points of all scans.  A scan is sloped if its true ground strays from one plane by more than 0.15 m (standard
deviation), else flat.  Patchwork++ joins if `pypatchworkpp` is installed (`pip install envpred[bench]`), with its own
defaults but for the sensor's height.

Free space: the share of free cells of the label grid that hold a return from something that is no ground and is lower
than 2 m above the road (vegetation counts here), and the share whose centre lies in the true box of an object.
"""

import argparse
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envpred.build.grids import mapped, mapper_of
from envpred.drives import Drive, find_drives
from envpred.drives.kitti import KittiDrive
from envpred.drives.tracklets import Tracklet
from envpred.mapping.geometry import FREE, PAPER_SENSOR_HEIGHT, GridSpec
from envpred.mapping.ground import MarkovRandomField, RansacPlane
from envpred.mapping.mapper import MappingParameters
from envpred.simulate import classes
from envpred.simulate.run import simulate

Segmenter = Callable[[NDArray[np.float32]], NDArray[np.bool_]]

REACH, CEILING, STRAYS = GridSpec().reach, 3.5, 0.15  # metres


def segmenters() -> dict[str, Segmenter]:
    """What is compared, fresh for a drive: name -> (points -> which are obstacles)."""
    found: dict[str, Segmenter] = {
        "MRF": partial(MarkovRandomField().obstacles, reach=REACH),
        "RANSAC 0.2 m": partial(RansacPlane().obstacles, reach=REACH),
    }
    try:
        import pypatchworkpp
    except ImportError:
        return found
    parameters = pypatchworkpp.Parameters()
    parameters.verbose = False
    parameters.sensor_height = PAPER_SENSOR_HEIGHT

    def obstacles(segmenter: Any, points: NDArray[np.float32]) -> NDArray[np.bool_]:
        segmenter.estimateGround(points)
        obstacle = np.zeros(len(points), bool)
        obstacle[segmenter.getNongroundIndices()] = True
        return obstacle

    # It adapts its thresholds to the scans it has seen: as its authors run it, and every scan on its own.
    with silent():
        adapting = pypatchworkpp.patchworkpp(parameters)

    def alone(points: NDArray[np.float32]) -> NDArray[np.bool_]:
        with silent():
            segmenter = pypatchworkpp.patchworkpp(parameters)
        return obstacles(segmenter, points)

    return found | {"Patchwork++": partial(obstacles, adapting), "Patchwork++, scans alone": alone}


@contextmanager
def silent() -> Iterator[None]:
    """Keeps what a C++ library prints off the screen."""
    sys.stdout.flush()
    screen = os.dup(1)
    with open(os.devnull, "w", encoding="utf-8") as nowhere:
        os.dup2(nowhere.fileno(), 1)
    try:
        yield
    finally:
        os.dup2(screen, 1)
        os.close(screen)


def read_truth(drive: Drive, frame: int) -> NDArray[np.uint16]:
    """Class numbers (N,) of a simulated scan's points."""
    assert isinstance(drive, KittiDrive)
    return classes.semantic(np.fromfile(drive.folder / "labels" / f"{frame:010d}.label", np.uint32))


def is_sloped(ground: NDArray[np.float32]) -> bool:
    """Whether ground points (N, 3) stray from their best plane."""
    design = np.column_stack([ground[:, :2], np.ones(len(ground))])
    plane = np.linalg.lstsq(design, ground[:, 2], rcond=None)[0]
    return bool((ground[:, 2] - design @ plane).std() > STRAYS)


def score_ground(drives: list[Drive], every: int) -> dict[tuple[str, str], tuple[float, float, float]]:
    """(segmenter, "flat"/"sloped"/"all") -> precision, recall, F1 of ground."""
    counts: dict[tuple[str, str], NDArray[np.int64]] = {}
    for drive in drives:
        methods = segmenters()
        for frame in drive.frames[::every]:
            points, truth = drive.scan(frame), read_truth(drive, frame)
            ground = np.isin(truth, classes.GROUND)
            judged = (
                (np.abs(points[:, :2]) <= REACH).all(axis=1) & (points[:, 2] <= CEILING) & (truth != classes.VEGETATION)
            )
            where = "sloped" if is_sloped(points[ground & judged, :3]) else "flat"
            for name, obstacles in methods.items():
                said = ~obstacles(points)[judged]
                true = ground[judged]
                hits = np.array([(said & true).sum(), (said & ~true).sum(), (~said & true).sum()])
                for key in ((name, where), (name, "all")):
                    counts[key] = counts.get(key, np.zeros(3, np.int64)) + hits
    return {
        key: (tp / max(tp + fp, 1), tp / max(tp + fn, 1), 2 * tp / max(2 * tp + fp + fn, 1))
        for key, (tp, fp, fn) in counts.items()
    }


def share_beside_objects(drives: list[Drive], every: int) -> float:
    """Share of the ground points that the random field calls obstacles and that lie in one of its cells with an object.

    The field decides on whole cells of 0.4 m, so that the ground at the foot of every object is lost with it.
    """
    field = MarkovRandomField()
    beside, lost = 0, 0
    for drive in drives:
        for frame in drive.frames[::every]:
            points, truth = drive.scan(frame), read_truth(drive, frame)
            ground = np.isin(truth, classes.GROUND)
            cells = np.round(points[:, :2] / field.cell).astype(np.int64) @ [1 << 20, 1]
            missed = cells[ground & field.obstacles(points, REACH)]
            lost += len(missed)
            beside += int(np.isin(missed, cells[~ground & (points[:, 2] <= CEILING)]).sum())
    return beside / max(lost, 1)


def score_free(drives: list[Drive], every: int) -> tuple[float, float]:
    """Share of free cells that hold an object's return, and share whose centre lies in an object's box."""
    spec, free, hit, boxed = GridSpec(), 0, 0, 0
    for drive in drives:
        objects = drive.tracklets()
        mapper = mapper_of(drive, MappingParameters(spec))
        origin = mapper.origin
        assert origin is not None
        for k, seen in enumerate(mapped(drive, mapper)):
            if k % every:
                continue
            frame, points = drive.frames[k], drive.scan(drive.frames[k])
            label, centre = seen.label, seen.centre_cell
            sensor = drive.poses[k] @ drive.sensor_to_body()
            is_free = label == FREE
            free += int(is_free.sum())
            thing = ~np.isin(read_truth(drive, frame), classes.GROUND) & (points[:, 2] < 2.0 - PAPER_SENSOR_HEIGHT)
            world = points[thing, :3] @ sensor[:3, :3].T + sensor[:3, 3]
            cells = spec.cell_of(world, origin) - centre + spec.half
            cells = cells[((cells >= 0) & (cells < spec.cells)).all(axis=1)]
            held = np.zeros_like(is_free)
            held[cells[:, 0], cells[:, 1]] = True
            hit += int((held & is_free).sum())
            boxed += int((_covered(objects, frame, sensor, origin, centre, spec) & is_free).sum())
    return hit / max(free, 1), boxed / max(free, 1)


def _covered(
    objects: list[Tracklet],
    frame: int,
    sensor: NDArray[np.float64],
    origin: NDArray[np.float64],
    centre: NDArray[np.int32],
    spec: GridSpec,
) -> NDArray[np.bool_]:
    """Cells (H, W) whose centre lies in the box of an object, seen from above."""
    index = np.stack(np.meshgrid(np.arange(spec.cells), np.arange(spec.cells), indexing="ij"), axis=-1).reshape(-1, 2)
    world = (index + centre - spec.half) * spec.resolution + origin
    away = np.column_stack([world - sensor[:2, 3], np.zeros(len(world))])
    heading = np.arctan2(sensor[1, 0], sensor[0, 0])
    c, s = np.cos(heading), np.sin(heading)
    local = np.column_stack([c * away[:, 0] + s * away[:, 1], c * away[:, 1] - s * away[:, 0], away[:, 2]])
    covered = np.zeros(len(local), bool)
    for thing in objects:
        if frame in thing.frames:
            local[:, 2] = thing.poses[frame - thing.first][2] + 0.1
            covered |= thing.contains(frame, local)
    return covered.reshape(spec.cells, spec.cells)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "folder", nargs="?", type=Path, help="simulated drives; by default 8 drives of 60 scans are made"
    )
    parser.add_argument("--every", type=int, default=2, help="score every so many scans")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as made:
        folder = arguments.folder or Path(made) / "drives"
        if arguments.folder is None:
            simulate(folder, drives=8, frames=60, seed=7)
        drives = find_drives(folder)
        print(f"{'':26}{'where':8}{'precision':>10}{'recall':>8}{'F1':>8}")
        for (name, where), (precision, recall, f1) in sorted(score_ground(drives, arguments.every).items()):
            print(f"{name:26}{where:8}{precision:10.4f}{recall:8.4f}{f1:8.4f}")
        beside = share_beside_objects(drives, arguments.every)
        print(f"ground that the MRF loses: {beside:.3f} of it lies within a cell of 0.4 m that holds an object, too")
        hit, boxed = score_free(drives, arguments.every)
        print(f"free cells with a return from an object: {hit:.5f}; in an object's box: {boxed:.5f}")


if __name__ == "__main__":
    main()
