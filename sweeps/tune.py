"""Tune the hyperparameters of a model on one input variant: a study of runs of `envpred fit`, on one machine or many.

    envpred tune --variant dst_dogma --trials 40 --space prednet --store grids/

The same command started again, here or on another machine that sees the folder or the database, joins the study; after
an interruption it goes on with it.  Options of `envpred fit` (--config, --model.*, --data.*, --trainer.*) go to every
trial.  The folder of the study then holds best.yaml, trials.csv, pictures, and each trial's configuration, log and
TensorBoard run:

    envpred fit --config studies/prednet_dst_dogma/best.yaml
    tensorboard --logdir studies/prednet_dst_dogma/trials
    optuna-dashboard studies/prednet_dst_dogma/journal.log      # pip install 'envpred[dashboard]'

`--workers 4` is four of them on this machine, each with its share of the cores; Ctrl-C ends them all.  A worker uses
the devices that it sees: where each is to have its own, start each by a command, with its CUDA_VISIBLE_DEVICES.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import optuna

from envpred.cli.arguments import FitArguments, names_configuration
from envpred.datamodules import GridDataModule
from envpred.errors import UserError, check_number
from envpred.interrupts import noted
from envpred.results.result import short_name
from envpred.store import digest
from envpred.store.files import replace_text
from envpred.store.parts import sweep_below

from .runs.cluster import on_cluster
from .runs.command import command_line, run, say
from .runs.trial import DEFAULTS, Runner, TrialFailedError
from .runs.trial import fit as fit_command
from .runs.workers import beside
from .study import sampling
from .study.best import write_best
from .study.pictures import draw
from .study.sampling import PrunerName, SamplerName
from .study.space import Space, read_space
from .study.storage import JOURNAL, hidden, open_storage, told
from .study.trials import TRIALS, trials_csv
from .study.worker import ARGUMENTS, Worker, failed_with, open_study


def tune(
    variant: str,
    space: str,
    store: Path,
    fit: list[str],
    trials: int = 40,
    out: Path = Path("studies"),
    name: str | None = None,
    storage: str | None = None,
    sampler: SamplerName = "tpe",
    pruner: PrunerName = "median",
    seed: int = 0,
    grace: float = 60.0,
    max_failures: int = 5,
    force: bool = False,
    workers: int = 1,
    cluster: str | None = None,
) -> None:
    """Tune hyperparameters for an input variant: work on a study until it has the trials asked for.

    Args:
        variant: input variant that is tuned for.
        space: what is searched: a name that ships (`envpred configs`), or a YAML file (see `sweeps.study.space`).
        store: folder that `envpred grids` wrote.
        fit: options of `envpred fit` that every trial starts from; by default the space's own configuration.
        trials: complete trials that the study is to hold at its end; pruned and failed ones come on top.
        out: folder for studies.
        name: of the study; by default <model>_<variant>.
        storage: URL of a database for the study, such as postgresql+psycopg://user@host/optuna; by default a journal in
            its folder.
        sampler: tpe, or random.
        pruner: median, hyperband, or none; what it ends early is not complete.
        seed: of the sampler.
        grace: seconds of silence after which a worker on another machine counts as dead, and its trial is run again.
        max_failures: trials that may fail in a row before it is all given up.
        force: go on with a study of other grids, another space or another configuration.
        workers: trials at once on this machine, which share its cores and devices; small networks use one core best.
        cluster: address of a Dask scheduler; each of its workers joins the study, and this command waits.
    """
    check_number("trials", trials, 1)
    check_number("seed", seed, 0, 2**32 - 1)
    check_number("grace", grace, above=True)
    check_number("max_failures", max_failures, 1)
    check_number("workers", workers, 1)
    read = read_space(space)
    options = [*_configs(read, fit), *fit, f"--data.variant={variant}", f"--data.store={store}"]
    base = FitArguments(options)
    read.check(base)
    if cluster is None:
        base.check_devices()
    model = short_name(base.base["model"]["class_path"].rsplit(".", 1)[1])
    name = name or f"{model}_{variant}"
    folder = out / name
    identity = {"space": read.hash, "data": data_hash(base.base["data"]), "configuration": _configuration_hash(base)}
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    with told(folder, storage), noted():
        kept = open_storage(folder, storage)
        study = open_study(
            kept, name, identity, sampling.sampler(sampler, seed, read.values_in(base)), sampling.pruner(pruner), force
        )
        read.check_joins(study)
        same = {
            "variant": variant,
            "space": space,
            "store": store,
            "trials": trials,
            "out": out,
            "name": name,
            "storage": storage,
            "sampler": sampler,
            "pruner": pruner,
            "seed": seed,
            "grace": grace,
            "max_failures": max_failures,
            "force": force,
        }
        if cluster is not None:
            on_cluster(cluster, command_line("tune", {**same, "workers": workers}, fit))
        elif workers > 1:
            beside(workers, "tune", command_line("tune", same, fit))
            return  # they have written what the study found
        else:
            objective = Objective(study, read, base, Runner(folder / "trials", fit_command))
            with noted(later=True):  # the study's journal is locked now and then
                Worker(study, kept, trials, objective, grace, max_failures, say=say).work()
        place = hidden(storage) if storage else str(folder / JOURNAL)
        sweep_below(folder / "trials")  # a trial that was killed is run again in a folder of its own
        say(f"best of {trials}: {write_best(study, base, identity, place, folder)}")
        replace_text(folder / TRIALS, trials_csv(study))
        draw(study, folder)


@dataclass(frozen=True)
class Objective:
    """What a trial's values are worth: the validation error of a run of `envpred fit` with them."""

    study: optuna.Study
    space: Space
    fit: FitArguments
    runner: Runner

    def __call__(
        self, trial: optuna.Trial, on_rung: Callable[[int, float], None], on_poll: Callable[[], None]
    ) -> float:
        arguments = self.space.suggest(trial)
        trial.set_user_attr(ARGUMENTS, arguments)
        before = failed_with(self.study, arguments)
        if before is not None:
            raise TrialFailedError(f"not run: trial {before.number} ran out of memory with the same values", True)
        return self.runner.run(trial.number, self.fit.complete(arguments, DEFAULTS), on_rung, on_poll)


def data_hash(options: Mapping[str, Any]) -> str:
    """What tells the training and validation windows of a data configuration from others; the test's do not count."""
    data = GridDataModule(**options)
    data.setup("fit")
    told_of = [data.describe(part) for part in ("train", "val")]
    return digest([{k: v for k, v in part.items() if k not in ("store", "split")} for part in told_of])


def _configuration_hash(fit: FitArguments) -> str:
    """What trials start from; where the store lies does not matter."""
    return digest({**fit.base, "data": {k: v for k, v in fit.base["data"].items() if k != "store"}})


def _configs(space: Space, fit: list[str]) -> list[str]:
    """The space's own configuration, unless others are given."""
    if names_configuration(fit):
        return []
    if not space.config:
        raise UserError(f"{space.file}: names no configuration to start from; give one, as by --config prednet_small")
    return [f"--config={file}" for file in space.config]


def main(args: list[str] | None = None) -> None:
    """Entry point of `envpred tune` and `python -m sweeps.tune`."""
    run(tune, "tune", args)


if __name__ == "__main__":
    main()
