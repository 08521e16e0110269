"""Every kind of file that is read back: how the program writes it, and what reads it, as its commands do."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from random import Random

from tests.faults import grid_files as grids
from tests.faults import run_files as runs


@dataclass(frozen=True)
class Kind:
    """A kind of file.

    Args:
        write: writes an example into a new folder.
        files: glob of those that are mutated, in it.
        read: reads it, as commands do; what is drawn decides which, and what it returns is a right result.
        share: of 10,000 mutations.
        written: globs of what reading may write, in it.
        exact: whether what is read of it is checked by a checksum, so that no other result is right.
        paths: whether no path in it may lead elsewhere.
        slow: whether writing the example takes seconds.
    """

    write: Callable[[Path], object]
    files: str
    read: Callable[[Path, Random], object]
    share: int
    written: tuple[str, ...] = ()
    exact: bool = False
    paths: bool = True
    slow: bool = False


HIDDEN = ("grids/.*",)
KINDS = {
    "manifest of a drive": Kind(grids.write_grids, "grids/*/manifest.json", grids.read_store, 1900, HIDDEN),
    "store.json": Kind(grids.write_grids, "grids/store.json", grids.read_store, 700, ("grids/*",)),
    ".checked.json": Kind(grids.write_grids, "grids/.checked.json", grids.read_store, 200, HIDDEN, exact=True),
    "grids": Kind(grids.write_grids, "grids/*/*.npy", grids.read_store, 1000, HIDDEN, exact=True),
    "KITTI drive, text": Kind(grids.write_kitti, "drives/**/*.txt", grids.read_drives, 800),
    "KITTI drive, tracklets": Kind(grids.write_kitti, "drives/**/*.xml", grids.read_drives, 200),
    "KITTI drive, scans": Kind(grids.write_kitti, "drives/**/*.bin", grids.read_drives, 370),
    "odometry sequence": Kind(grids.write_odometry, "drives/**/*.txt", grids.read_drives, 500),
    "folder, settings and poses": Kind(grids.write_folders, "drives/npy/*.*", grids.read_drives, 500, paths=False),
    "folder, scans": Kind(grids.write_folders, "drives/*/lidar/*", grids.read_drives, 400),
    "result.json": Kind(runs.write_results, "prednet_*/result.json", runs.read_results, 1000),
    "drawn.npz": Kind(runs.write_results, "prednet_*/drawn.npz", runs.read_results, 300),
    "predictions, manifest": Kind(runs.write_predictions, "predictions/manifest.json", runs.read_predictions, 700),
    "predictions, arrays": Kind(runs.write_predictions, "predictions/*/*.npy", runs.read_predictions, 300, exact=True),
    "validations.json": Kind(runs.write_training, "run/validations.json", runs.read_validations, 500, slow=True),
    "checkpoint": Kind(
        runs.write_training, "run/checkpoints/last.ckpt", runs.read_any_checkpoint, 250, ("grids/.*",), slow=True
    ),
    "weights, configuration": Kind(runs.write_weights, "weights/tiny/config.json", runs.read_weights, 500, slow=True),
    "weights, arrays": Kind(
        runs.write_weights, "weights/tiny/model.safetensors", runs.read_weights, 250, exact=True, slow=True
    ),
    "Keras weights": Kind(
        runs.write_keras, "weights.npz", lambda f, _: runs.initialise(f / "weights.npz", [8, 16]), 250
    ),
    "recording": Kind(grids.write_recording, "traffic.npz", grids.read_recording, 250),
    "simulated.json": Kind(
        grids.write_simulated, "drives/simulated.json", grids.read_simulated, 100, ("drives/.lock",), slow=True
    ),
    "labels": Kind(grids.write_simulated, "drives/**/*.label", grids.read_scan, 30, slow=True),
    "configuration": Kind(
        runs.write_configuration, "runs/**/config.yaml", runs.read_configuration, 250, paths=False, slow=True
    ),
    "search space": Kind(runs.write_space, "space.yaml", runs.read_any_space, 300),
    "study": Kind(runs.write_study, "journal.log", runs.read_study, 300, (".", "journal.log*")),
}
