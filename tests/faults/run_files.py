"""Files of runs and of what they are told: how the program writes them, and what reads them, as its commands do."""

import contextlib
import json
import shutil
from pathlib import Path
from random import Random

import optuna

from envpred.callbacks import PredictionWriter, Validations
from envpred.cli import main
from envpred.cli.draw import draw
from envpred.cli.export import export
from envpred.models import LastFrame
from envpred.models.checkpoints import read_checkpoint
from envpred.models.loading import load_forecaster
from envpred.report.details import metric_tables, models_table
from envpred.report.how_sure import cells_table, how_sure_table
from envpred.report.page import page, pictures_of
from envpred.report.paragraph import paragraph
from envpred.report.pictures import compared_scenes
from envpred.report.ratios import ratio_table
from envpred.report.runs import read_runs
from envpred.report.seeds import average_seeds, seeds_table
from envpred.report.tables import methods_table, variants_table
from envpred.results.predictions import Predictions
from envpred.store import Store
from sweeps.runs.progress import Progress, check_ended
from sweeps.study.sampling import pruner, sampler
from sweeps.study.space import read_space
from sweeps.study.storage import open_storage
from sweeps.study.trials import trials_csv
from sweeps.study.worker import open_study
from tests.conftest import shared_folder
from tests.models.trainers import grids, prednet, trainer
from tests.remedies import command
from tests.report.conftest import animation, draw_windows, written
from tests.store.stores import write_store


def write_results(folder: Path) -> None:
    for n in range(2):
        run = written(folder, seed=n)
        (run / "strip.gif").write_bytes(animation())
        record = json.loads((run / "result.json").read_text())
        (run / "result.json").write_text(json.dumps(record | {"pictures": {"window_2": "strip.gif"}}))
        draw_windows(run)


def read_results(folder: Path, random: Random) -> None:
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
    page(read, paragraph(read, []), measured, [], appendix, {}, [], pictures_of(read))


def write_predictions(folder: Path) -> None:
    store = write_store(folder / "grids", {name: list(range(24)) for name in "ab"}, cells=8)
    run = trainer(folder / "run", callbacks=[PredictionWriter(folder / "predictions")])
    run.predict(LastFrame(given=3), datamodule=grids(store, test=["a"]), return_predictions=False)


def read_predictions(folder: Path, random: Random) -> object:
    store = Store(folder / "grids")
    if random.randrange(60) == 0:
        draw([folder / "predictions"], folder / "out" / "strip.png", store=store.folder)
        return None
    found = Predictions(folder / "predictions")
    assert found.label
    seen = random.choice((store, None))
    scenes = [found.scene(k, seen) for k in range(len(found.windows))]
    return [grids.tobytes() for scene in scenes for grids in (scene.seen, *scene.forecasts.values())]


def write_training(folder: Path) -> None:
    store = write_store(folder / "grids", {name: list(range(24)) for name in "abc"}, cells=8)
    model = prednet(channels=[2], t1_epochs=2, t1_drop_epoch=1, t5_epochs=1, t5_drop_epoch=1)
    trainer(folder / "run", callbacks=[Validations()]).fit(model, datamodule=grids(store))


def read_validations(folder: Path, random: Random) -> None:
    progress = Progress(folder / "run", 3)
    progress.new_rungs()
    with contextlib.suppress(IndexError):
        check_ended(folder / "run", 3)
    progress.score()


def read_any_checkpoint(folder: Path, random: Random) -> None:
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
        initialise(file, [2])
    else:
        load_forecaster(file)


def write_keras(folder: Path) -> None:
    shutil.copy(shared_folder() / "reference" / "prednet_keras_c2.npz", folder / "weights.npz")


def initialise(file: Path, channels: list[int]) -> None:
    model = prednet(channels=channels, init_from=str(file))
    model.initialise(str(file))


def write_weights(folder: Path) -> None:
    write_training(folder)
    export(folder / "run", "tiny", folder / "weights", [])


def read_weights(folder: Path, random: Random) -> list[float]:
    """The sums of what is read."""
    place = folder / "weights" / "tiny"
    if random.randrange(4):
        read = load_forecaster(place)
    else:
        read = prednet(channels=[2])
        read.initialise(str(place))
    return [float(tensor.sum()) for tensor in read.state_dict().values()]


def write_configuration(folder: Path) -> None:
    write_store(folder / "grids", {name: list(range(24)) for name in "abc"}, cells=8)
    main(["fit", "--config=prednet_small", f"--data.store={folder / 'grids'}", "--model.t1_epochs=1", "--data.length=8",
          "--data.given=3", "--model.channels=[2]", "--model.t5_epochs=0", "--data.samples=1", "--data.crop=8",
          "--model.first_scored=2", "--pictures.every_n_epochs=0", f"--out={folder / 'runs'}"])  # fmt: skip


def read_configuration(folder: Path, random: Random) -> None:
    (run,) = (folder / "runs").rglob("version_0")
    command(random.choice(("fit", "test")), f"--config={run / 'config.yaml'}", "--print_config")


def write_space(folder: Path) -> None:
    shutil.copy(Path(__file__).parents[2] / "sweeps" / "spaces" / "prednet.yaml", folder / "space.yaml")


def read_any_space(folder: Path, random: Random) -> None:
    space = read_space(folder / "space.yaml")
    study = optuna.create_study()
    assert space.hash
    space.suggest(study.ask())


def write_study(folder: Path) -> None:
    study = open_study(open_storage(folder, None), "a", {"data": "b"}, sampler("tpe", 0), pruner("median"))
    study.optimize(lambda trial: trial.suggest_float("x", 0, 1), n_trials=4)


def read_study(folder: Path, random: Random) -> None:
    study = open_study(open_storage(folder, None), "a", {"data": "b"}, sampler("tpe", 0), pruner("median"))
    study.ask().suggest_float("x", 0, 1)
    trials_csv(study)
