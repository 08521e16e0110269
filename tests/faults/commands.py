"""The commands that take long, as small as they still have something to lose, and what of their outcome is the same.

A further one is a further line of `COMMANDS`.
"""

import hashlib
import json
import shutil
from pathlib import Path
from typing import Any

import optuna
import torch
import yaml
from optuna.trial import TrialState

from envpred.build.grids import build
from envpred.results.result import RESULT
from envpred.results.validations import read_validations
from sweeps.study.retry import REASON, RETRY_OF
from sweeps.study.storage import open_storage
from tests.build import builds
from tests.faults.kills import Command, Options, is_mark
from tests.store.stores import write_store

# Each training takes a second: four layers' worth of nothing, on grids of 16 cells.
TINY = ["--config=prednet_small", "--model.channels=[4]", "--data.crop=null", "--trainer.accelerator=cpu"]
FIT = ["--trainer.enable_progress_bar=false", "--trainer.enable_model_summary=false", "--pictures.every_n_epochs=0"]
TRIALS = 2
NOT_COMPARED = ("revision", "forecast_seconds_per_window")  # of a result: the state of the checkout, and a time


def write_inputs(folder: Path) -> None:
    """Drives, a store of grids to train on, one to add velocities to, and a space to tune in."""
    for number, frames in (("0001", 40), ("0002", 90), ("0003", 60)):
        builds.write_long_drive(folder / "drives", number, frames)
        builds.write_long_drive(folder / "short", number, 22)
    write_store(folder / "grids", {name: list(range(40)) for name in "abc"}, dogma=True)
    build(folder / "drives", folder / "mapped", workers=1)
    (folder / "space.yaml").write_text("model.t1_lr: {choices: [0.001, 0.003]}\n")


def hashes(work: Path) -> dict[str, str]:
    """Every file by its content, but for marks."""
    files = [file for file in work.rglob("*") if file.is_file() and not is_mark(file)]
    return {str(file.relative_to(work)): hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


def copy_mapped(inputs: Path, work: Path) -> None:
    shutil.copytree(inputs / "mapped", work / "grids")


def drives_are_whole(work: Path) -> None:
    if (work / "grids" / "store.json").exists():
        builds.all_valid(work / "grids")


def last_or_again(options: Options, work: Path, said: str) -> Options:
    """What a fit says how to go on; a killed one says nothing, and is gone on with from its last checkpoint."""
    options = [option for option in options if not option.startswith("--ckpt_path")]
    last = next(work.glob("runs/fit/*/*/*/checkpoints/last.ckpt"), None)
    told = [line.split("--ckpt_path ")[1].removesuffix(" to go on") for line in said.splitlines() if "--ckpt" in line]
    assert all(last == work / file for file in told if "interrupted" in said), told
    return [*options, "--ckpt_path=last"] if last else options


def trained(work: Path) -> dict[str, Any]:
    """Weights, optimiser and validations of the one run that has reached its end; others have nothing to go on from."""
    runs = [folder for folder in work.glob("runs/fit/*/*/*") if folder.is_dir()]
    (ended,) = [run for run in runs if read_validations(run).ended is not None]
    assert not [run for run in runs if run != ended and any(run.rglob("last.ckpt"))]
    found: dict[str, Any] = {"validations": read_validations(ended).as_json()}
    for file in sorted(ended.rglob("*.ckpt")):
        checkpoint = torch.load(file, weights_only=True)
        for part in ("state_dict", "optimizer_states", "lr_schedulers", "epoch", "global_step"):
            found[f"{file.name} {part}"] = plain(checkpoint[part])
    return found


def plain(value: Any) -> Any:
    """Nested values with tensors as what compares by `==`."""
    if isinstance(value, torch.Tensor):
        return [list(value.shape), hashlib.sha256(value.numpy().tobytes()).hexdigest()]
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    return [plain(item) for item in value] if isinstance(value, list | tuple) else value


def tuned(work: Path) -> dict[Any, Any]:
    """What was found of each value, and that no trial was lost, run twice, or failed of its own."""
    (folder,) = (work / "studies").iterdir()
    study = optuna.load_study(study_name=folder.name, storage=open_storage(folder, None))
    complete = [trial for trial in study.trials if trial.state == TrialState.COMPLETE]
    failed = [trial for trial in study.trials if trial.state == TrialState.FAIL]
    again = [trial.user_attrs[RETRY_OF] for trial in study.trials if RETRY_OF in trial.user_attrs]
    assert len(complete) == TRIALS, [trial.state for trial in study.trials]
    assert len(complete) + len(failed) == len(study.trials), [trial.state for trial in study.trials]
    assert not [trial.user_attrs[REASON] for trial in failed if REASON in trial.user_attrs]
    assert sorted(again) == [trial.number for trial in failed], (again, [trial.number for trial in failed])
    assert len((folder / "trials.csv").read_text().splitlines()) == 1 + len(study.trials)
    best = yaml.safe_load((folder / "best.yaml").read_text())["model"]["init_args"]["t1_lr"]
    values = {tuple(trial.params.values()): trial.values for trial in complete}
    assert values[(best,)] == min(values.values())
    return values


def alike_where_both_looked(expected: dict[Any, Any], found: dict[Any, Any]) -> bool:
    """What a study draws depends on how many trials there are, lost ones too; what it finds there does not."""
    return all(found[drawn] == expected[drawn] for drawn in {*expected} & {*found})


def ablated(work: Path) -> dict[str, Any]:
    """Grids, results, and of the reports their tables and the names of all files beside them."""
    report = work / "ablation" / "report"
    tables = [file.read_text() for file in sorted(report.rglob("methods.md"))]
    assert tables
    return {**hashes(work / "ablation" / "stores"), **results(work), **names(report), "tables": tables}


def published(work: Path) -> dict[str, Any]:
    """Grids, results, and of the page its tables and the names of all files beside it."""
    out = work / "paper"
    tables = {name: (out / name).read_text() for name in ("table_1.md", "methods.md", "conclusions.md")}
    return {**hashes(out / "grids"), **results(work), **tables, "files": [file.name for file in sorted(out.iterdir())]}


def results(work: Path) -> dict[str, Any]:
    """Every result but for times, by the name of its run."""
    found = {file.parent.name: json.loads(file.read_text()) for file in sorted(work.rglob(RESULT))}
    assert found
    for told in found.values():
        trained = told["model"]["trained"] or {}
        for name in ("seconds", "command"):  # a training that went on took other ones
            trained.pop(name, None)
    return {run: {k: v for k, v in told.items() if k not in NOT_COMPARED} for run, told in found.items()}


def names(folder: Path) -> dict[str, str]:
    """The names of all files in a folder."""
    return {str(file.relative_to(folder)): "is there" for file in folder.rglob("*") if file.is_file()}


COMMANDS = {
    "grids": Command(
        lambda inputs: ["grids", f"--source={inputs / 'drives'}", "--store=grids", "--workers=2"],
        hashes,
        check=drives_are_whole,
    ),
    "velocities": Command(
        lambda _: ["grids", "--store=grids", "--dogma", "--workers=2", "--particles.filter.persistent=20000"],
        hashes,
        prepare=copy_mapped,
        check=drives_are_whole,
    ),
    "simulate": Command(lambda _: ["simulate", "drives", "--drives=3", "--frames=8", "--workers=2"], hashes),
    "live": Command(
        lambda inputs: [
            *("live", str(inputs / "drives"), "--config=rollout", "--model.futures=2", "--model.movers=false"),
            *("--grid.cells=32", "--out=live.html"),
        ],
        hashes,
    ),
    "fit": Command(
        lambda inputs: [
            *("fit", *TINY, *FIT, "--config=dst_static", f"--data.store={inputs / 'grids'}", "--data.samples=8"),
            *("--model.t1_epochs=8", "--model.t5_epochs=8"),
        ],
        trained,
        go_on=last_or_again,
    ),
    "tune": Command(
        lambda inputs: [
            *("tune", *TINY, f"--store={inputs / 'grids'}", f"--space={inputs / 'space.yaml'}", f"--trials={TRIALS}"),
            *("--variant=dst_static", "--sampler=random", "--pruner=none", "--seed=2"),
            *("--model.t1_epochs=2", "--model.t5_epochs=2", "--data.samples=4"),
        ],
        tuned,
        alike=alike_where_both_looked,
    ),
    "ablate": Command(
        lambda inputs: [
            *("ablate", *TINY, f"--store={inputs / 'mapped'}", f"--source={inputs / 'drives'}", "--data.crop=16"),
            *("--variants=[]", "--switches=[ransac]", "--pictures.windows=1"),
            *("--model.t1_epochs=2", "--model.t5_epochs=2", "--data.samples=4"),
        ],
        ablated,
    ),
    "paper": Command(
        lambda inputs: [
            *("paper", f"--source={inputs / 'short'}", "--workers=2", "--trainer.accelerator=cpu"),
            *("--data.samples=2", "--data.val_windows=1", "--pictures.windows=1"),
        ],
        published,
    ),
}
