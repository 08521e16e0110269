"""Every kind of file that is read back: how the program writes it, and what reads it, as its commands do."""

import contextlib
import io
import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from random import Random

import numpy as np
import optuna
from matplotlib import pyplot

from envpred.build.grids import map_drive
from envpred.callbacks import PredictionWriter, Validations
from envpred.cli import main
from envpred.cli.commands import show, velocity, verify
from envpred.cli.draw import draw
from envpred.datamodules import GridDataModule
from envpred.drives import find_drives
from envpred.drives.plausible import oddities
from envpred.drives.tracklets import TRACKLETS, VISIBLE, Tracklet
from envpred.errors import UserError
from envpred.mapping.geometry import GridSpec
from envpred.mapping.mapper import MappingParameters
from envpred.models import LastFrame
from envpred.models.checkpoints import read_checkpoint
from envpred.models.loading import load_forecaster
from envpred.report.details import metric_tables, models_table
from envpred.report.how_sure import cells_table, how_sure_table
from envpred.report.page import page, pictures_of
from envpred.report.pictures import compared_scenes
from envpred.report.ratios import ratio_table
from envpred.report.runs import read_runs
from envpred.report.seeds import average_seeds, seeds_table
from envpred.report.tables import methods_table, variants_table
from envpred.results.predictions import Predictions
from envpred.simulate.pictures import scan_picture
from envpred.simulate.run import simulate
from envpred.simulate.tracklets import write
from envpred.simulate.traffic import LANES, Network, Recording, Track
from envpred.store import DriveWriter, Store
from sweeps.runs.progress import Progress, check_ended
from sweeps.study.sampling import pruner, sampler
from sweeps.study.space import read_space
from sweeps.study.storage import open_storage
from sweeps.study.trials import trials_csv
from sweeps.study.worker import open_study
from tests.conftest import shared_folder
from tests.drives.synthetic import write_drive, write_sequence
from tests.models.trainers import grids, prednet, trainer
from tests.report.conftest import animation, draw_windows, written
from tests.store.stores import write_store

MAPPING = MappingParameters(GridSpec(16, 1 / 3))


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


def _command(*args: str) -> None:
    """Run a command; what it refuses is raised as it was said."""
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            main(list(args))
    except SystemExit as end:
        if end.code not in (0, None):
            raise UserError(said.getvalue().strip()) from None


# --- stores ---------------------------------------------------------------------------------------------------------


def _store(folder: Path) -> None:
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


def _read_store(folder: Path, random: Random) -> object:
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


# --- drives ---------------------------------------------------------------------------------------------------------


def _drive(folder: Path) -> None:
    drive = write_drive(folder / "drives", frames=6, azimuths=24, images=True)
    box = Tracklet("Car", (4.2, 1.7, 1.5), 1, [(5.0 + k, 2.0, -1.7, 0.1 * k) for k in range(4)], [VISIBLE] * 4)
    write(drive / TRACKLETS, [box, box])


def _sequence(folder: Path) -> None:
    write_sequence(folder / "drives", frames=6, azimuths=24)


def _read_drives(folder: Path, random: Random) -> None:
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


# --- runs -----------------------------------------------------------------------------------------------------------


def _results(folder: Path) -> None:
    for n in range(2):
        run = written(folder, seed=n)
        (run / "strip.gif").write_bytes(animation())
        record = json.loads((run / "result.json").read_text())
        (run / "result.json").write_text(json.dumps(record | {"pictures": {"window_2": "strip.gif"}}))
        draw_windows(run)


def _read_results(folder: Path, random: Random) -> None:
    if random.randrange(60) == 0:
        draw(sorted(folder.glob("prednet_*")), folder / "out" / "strip.png")
        return
    read = read_runs(sorted(folder.glob("prednet_*")))
    runs = average_seeds(read)
    tables = [methods_table(runs, []), variants_table(runs, []), ratio_table(runs), seeds_table(read)]
    tables += [how_sure_table(runs), cells_table(runs)]
    measured = [table for table in tables if table is not None]
    compared_scenes(read)
    appendix = [*metric_tables(runs), models_table(read, folder / "out")]
    page(read, measured, [], appendix, {}, [], pictures_of(read))


def _predictions(folder: Path) -> None:
    store = write_store(folder / "grids", {name: list(range(24)) for name in "ab"}, cells=8)
    run = trainer(folder / "run", callbacks=[PredictionWriter(folder / "predictions")])
    run.predict(LastFrame(given=3), datamodule=grids(store, test=["a"]), return_predictions=False)


def _read_predictions(folder: Path, random: Random) -> object:
    store = Store(folder / "grids")
    if random.randrange(60) == 0:
        draw([folder / "predictions"], folder / "out" / "strip.png", store=store.folder)
        return None
    found = Predictions(folder / "predictions")
    assert found.label
    seen = random.choice((store, None))
    scenes = [found.scene(k, seen) for k in range(len(found.windows))]
    return [grids.tobytes() for scene in scenes for grids in (scene.seen, *scene.forecasts.values())]


def _training(folder: Path) -> None:
    store = write_store(folder / "grids", {name: list(range(24)) for name in "abc"}, cells=8)
    model = prednet(channels=[2], t1_epochs=2, t1_drop_epoch=1, t5_epochs=1, t5_drop_epoch=1)
    trainer(folder / "run", callbacks=[Validations()]).fit(model, datamodule=grids(store))


def _read_validations(folder: Path, random: Random) -> None:
    progress = Progress(folder / "run", 3)
    progress.new_rungs()
    with contextlib.suppress(IndexError):
        check_ended(folder / "run", 3)
    progress.score()


def _read_checkpoint(folder: Path, random: Random) -> None:
    file = folder / "run" / "checkpoints" / "last.ckpt"
    store = folder / "grids"
    read_checkpoint(file)  # as the command line does, before Lightning reads it
    kind = random.randrange(20)
    if kind == 0:
        again = trainer(folder / "out" / "run", callbacks=[Validations()])
        again.fit(prednet(channels=[2]), datamodule=grids(store), ckpt_path=file, weights_only=True)
    elif kind <= 2:
        trainer(folder / "out" / "run").test(
            prednet(channels=[2]), datamodule=grids(store), ckpt_path=file, weights_only=True, verbose=False
        )
    elif kind <= 4:
        _initialise(file, [2])
    else:
        load_forecaster(file)


def _keras(folder: Path) -> None:
    shutil.copy(shared_folder() / "reference" / "prednet_keras_c2.npz", folder / "weights.npz")


def _initialise(file: Path, channels: list[int]) -> None:
    model = prednet(channels=channels, init_from=str(file))
    model._initialise(file)


# --- simulation -----------------------------------------------------------------------------------------------------


def _recording(folder: Path) -> None:
    random = np.random.default_rng(0)
    tracks = [Track(k % 5, 4.0, 1.8, 3 * k, 0.5, random.uniform(-40, 40, (9, 2))) for k in range(5)]
    lanes = [(k, 3.0, np.array([[0.0, 0.0], [50.0, 1.0 + k]])) for k in range(len(LANES))]
    town = Network("here", lanes, [np.array([[0.0, 0], [1, 0], [1, 1]])], tracks)
    Recording(0.5, 60.0, [town]).save(folder / "traffic.npz")


def _read_recording(folder: Path, random: Random) -> None:
    recording = Recording.load(folder / "traffic.npz")
    for k, network in enumerate(recording.networks):
        network.longest(recording.interval)
        recording.motions(k)
    if random.randrange(50) == 0:
        _command("traffic", f"--out={folder / 'out' / 'a.png'}", f"--recording={folder / 'traffic.npz'}")


def _simulated(folder: Path) -> None:
    simulate(folder / "drives", drives=1, frames=2, workers=1)


def _read_simulated(folder: Path, random: Random) -> None:
    simulate(folder / "drives", drives=1, frames=2, workers=1)  # which only looks, where nothing is lacking


def _read_scan(folder: Path, random: Random) -> None:
    (drive,) = find_drives(folder / "drives")
    try:
        scan_picture(drive.folder, 0)  # type: ignore[attr-defined]
    finally:
        pyplot.close("all")


# --- configurations and studies -------------------------------------------------------------------------------------


def _configuration(folder: Path) -> None:
    write_store(folder / "grids", {name: list(range(24)) for name in "abc"}, cells=8)
    main(["fit", "--config=prednet_small", f"--data.store={folder / 'grids'}", "--model.t1_epochs=1", "--data.length=8",
          "--data.given=3", "--model.channels=[2]", "--model.t5_epochs=0", "--data.samples=1", "--data.crop=8",
          "--model.first_scored=2", "--pictures.every_n_epochs=0", f"--out={folder / 'runs'}"])  # fmt: skip


def _read_configuration(folder: Path, random: Random) -> None:
    (run,) = (folder / "runs").rglob("version_0")
    _command(random.choice(("fit", "test")), f"--config={run / 'config.yaml'}", "--print_config")


def _space(folder: Path) -> None:
    shutil.copy(Path(__file__).parents[2] / "sweeps" / "spaces" / "prednet.yaml", folder / "space.yaml")


def _read_space(folder: Path, random: Random) -> None:
    space = read_space(folder / "space.yaml")
    study = optuna.create_study()
    assert space.hash
    space.suggest(study.ask())


def _study(folder: Path) -> None:
    study = open_study(open_storage(folder, None), "a", {"data": "b"}, sampler("tpe", 0), pruner("median"))
    study.optimize(lambda trial: trial.suggest_float("x", 0, 1), n_trials=4)


def _read_study(folder: Path, random: Random) -> None:
    study = open_study(open_storage(folder, None), "a", {"data": "b"}, sampler("tpe", 0), pruner("median"))
    study.ask().suggest_float("x", 0, 1)
    trials_csv(study)


HIDDEN = ("grids/.*",)
KINDS = {
    "manifest of a drive": Kind(_store, "grids/*/manifest.json", _read_store, 1900, HIDDEN),
    "store.json": Kind(_store, "grids/store.json", _read_store, 700, ("grids/*",)),
    ".checked.json": Kind(_store, "grids/.checked.json", _read_store, 200, HIDDEN, exact=True),
    "grids": Kind(_store, "grids/*/*.npy", _read_store, 1000, HIDDEN, exact=True),
    "KITTI drive, text": Kind(_drive, "drives/**/*.txt", _read_drives, 800),
    "KITTI drive, tracklets": Kind(_drive, "drives/**/*.xml", _read_drives, 200),
    "KITTI drive, scans": Kind(_drive, "drives/**/*.bin", _read_drives, 370),
    "odometry sequence": Kind(_sequence, "drives/**/*.txt", _read_drives, 500),
    "result.json": Kind(_results, "prednet_*/result.json", _read_results, 1000),
    "drawn.npz": Kind(_results, "prednet_*/drawn.npz", _read_results, 300),
    "predictions, manifest": Kind(_predictions, "predictions/manifest.json", _read_predictions, 700),
    "predictions, arrays": Kind(_predictions, "predictions/*/*.npy", _read_predictions, 300, exact=True),
    "validations.json": Kind(_training, "run/validations.json", _read_validations, 500, slow=True),
    "checkpoint": Kind(_training, "run/checkpoints/last.ckpt", _read_checkpoint, 250, ("grids/.*",), slow=True),
    "Keras weights": Kind(_keras, "weights.npz", lambda f, _: _initialise(f / "weights.npz", [8, 16]), 250),
    "recording": Kind(_recording, "traffic.npz", _read_recording, 250),
    "simulated.json": Kind(_simulated, "drives/simulated.json", _read_simulated, 100, ("drives/.lock",), slow=True),
    "labels": Kind(_simulated, "drives/**/*.label", _read_scan, 30, slow=True),
    "configuration": Kind(_configuration, "runs/**/config.yaml", _read_configuration, 250, paths=False, slow=True),
    "search space": Kind(_space, "space.yaml", _read_space, 300),
    "study": Kind(_study, "journal.log", _read_study, 300, (".", "journal.log*")),
}
