"""Files of drives and grids: how the program writes them, and what reads them, as its commands do."""

import shutil
from pathlib import Path
from random import Random

import numpy as np
from matplotlib import pyplot
from pypcd4.pypcd4 import Encoding, PointCloud

from envpred.build.grids import map_drive
from envpred.cli.commands import show, velocity, verify
from envpred.datamodules import GridDataModule
from envpred.drives import find_drives
from envpred.drives.plausible import oddities
from envpred.drives.tracklets import TRACKLETS, VISIBLE, Tracklet
from envpred.mapping.geometry import GridSpec
from envpred.mapping.mapper import MappingParameters
from envpred.simulate.pictures import scan_picture
from envpred.simulate.run import simulate
from envpred.simulate.tracklets import write
from envpred.simulate.traffic import LANES, Network, Recording, Track
from envpred.store import DriveWriter, Store
from tests.drives import own
from tests.drives.synthetic import motion, scans, write_drive, write_sequence
from tests.remedies import command
from tests.store.stores import write_store

MAPPING = MappingParameters(GridSpec(16, 1 / 3))


def write_grids(folder: Path) -> None:
    frames = {"a": list(range(3, 27)), "b": [*range(12), *range(14, 30)]}
    write_store(folder / "grids", frames, cells=8, context=16, dogma=True)
    verify(folder / "grids")
    _windows(folder / "grids", "test")


def _windows(store: Path, part: str, variant: str = "dst_static") -> list[bytes]:
    data = GridDataModule(store, variant, length=8, given=3, samples=2)
    data.setup({"test": "test", "train": "fit"}[part])
    data.describe(part)
    data.velocity_frame()
    first = [data.datasets[part][k]["seen"] for k in range(min(2, len(data.datasets[part])))]
    return [seen[name].numpy().tobytes() for seen in first for name in ("frames", "pose", "time", "label")]


def read_store(folder: Path, random: Random) -> object:
    store = folder / "grids"
    kind = random.randrange(40)
    if kind == 0:
        show(store, folder / "out" / "a.png", frame=2, context=random.random() < 0.5)
    elif kind == 1:
        velocity(store, folder / "out" / "v.png", frame=2)
    elif kind == 2:
        _complete(folder)
    elif kind <= 10:
        verify(store)
    elif kind <= 25:
        return _windows(store, "train", "dst_dogma")
    else:
        return _windows(store, "test")
    return None


def _complete(folder: Path) -> None:
    """Complete a drive of a copy of the store, whose manifest is read, replaced and tidied after."""
    copy = folder / "out" / "grids"
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(folder / "grids", copy)
    (copy / "mine.txt").write_text("kept")
    for name in list(Store(copy).drives):
        key = Store(copy).claim("dogma", {"filter": {"frame": "ego"}})
        with DriveWriter(copy, name, "dogma", key, {}) as out:
            out.add("velocity", np.float16, (2, 2)).extend(np.zeros((2, 2), np.float16))
    assert (copy / "mine.txt").read_text() == "kept"


def write_kitti(folder: Path) -> None:
    drive = write_drive(folder / "drives", frames=6, azimuths=24, images=True)
    box = Tracklet("Car", (4.2, 1.7, 1.5), 1, [(5.0 + k, 2.0, -1.7, 0.1 * k) for k in range(4)], [VISIBLE] * 4)
    write(drive / TRACKLETS, [box, box])


def write_odometry(folder: Path) -> None:
    write_sequence(folder / "drives", frames=6, azimuths=24)


def write_folders(folder: Path) -> None:
    """One recording as `.pcd`, which is compressed, one as `.ply`, one as `.npy` and one as `.bin`."""
    body = motion(4, speed=5.0)
    made = list(scans(body, 0.0, 24))
    times = np.asarray(0.1 * np.arange(4), np.float64)
    street = own.Recorded(made, [np.zeros(len(points)) for points in made], body, times)
    for ending in (".pcd", ".ply", ".npy", ".bin"):
        own.write(folder / "drives" / ending[1:], street, ending, {"grid": {"cells": 16}})
    for k, points in enumerate(made):
        PointCloud.from_xyzi_points(points).save(
            folder / "drives" / "pcd" / "lidar" / f"{k:05d}.pcd", Encoding.BINARY_COMPRESSED
        )


def read_drives(folder: Path, random: Random) -> None:
    for drive in find_drives(folder / "drives"):
        if not drive.frames:
            continue
        oddities(drive, drive.sensor_to_body())
        drive.stretches()
        drive.tracklets()
        if random.randrange(4) == 0:
            out = folder / "out" / "grids"
            shutil.rmtree(out, ignore_errors=True)
            out.mkdir(parents=True)
            map_drive(drive, out, MAPPING, {"mapping": Store(out).claim("mapping", MAPPING.as_dict())})
        else:
            for k in drive.frames:
                drive.scan(k)


def write_recording(folder: Path) -> None:
    random = np.random.default_rng(0)
    tracks = [Track(k % 5, 4.0, 1.8, 3 * k, 0.5, random.uniform(-40, 40, (9, 2))) for k in range(5)]
    lanes = [(k, 3.0, np.array([[0.0, 0.0], [50.0, 1.0 + k]])) for k in range(len(LANES))]
    town = Network("here", lanes, [np.array([[0.0, 0], [1, 0], [1, 1]])], tracks)
    Recording(0.5, 60.0, [town]).save(folder / "traffic.npz")


def read_recording(folder: Path, random: Random) -> None:
    recording = Recording.load(folder / "traffic.npz")
    for k, network in enumerate(recording.networks):
        network.longest(recording.interval)
        recording.motions(k)
    if random.randrange(50) == 0:
        command("traffic", f"--out={folder / 'out' / 'a.png'}", f"--recording={folder / 'traffic.npz'}")


def write_simulated(folder: Path) -> None:
    simulate(folder / "drives", drives=1, frames=2, workers=1)


def read_simulated(folder: Path, random: Random) -> None:
    simulate(folder / "drives", drives=1, frames=2, workers=1)  # which only looks, where nothing is lacking


def read_scan(folder: Path, random: Random) -> None:
    (drive,) = find_drives(folder / "drives")
    try:
        scan_picture(drive.folder, 0)  # type: ignore[attr-defined]
    finally:
        pyplot.close("all")
