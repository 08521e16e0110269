"""The paper's tables and figures, measured again, from drives to one page, as one command.

    envpred paper --out paper/                                      # simulated drives, two cores, 8 minutes
    envpred paper --out paper/ --source KITTI --preset small        # an evening on a GPU
    envpred paper --out paper/ --source KITTI --preset full --trials 40

Maps the drives, tunes where trials are asked for, trains PredNet with each input variant in two stages and the FCN,
tests them beside the static, particle and newer baselines, and writes `paper.html`, whose every number names its run.
Interrupt it whenever you like; the same command goes on, and what is done is not done again.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from envpred.cli.commands import grids, ground, velocity
from envpred.cli.draw import camera_of
from envpred.datamodules import GridDataModule
from envpred.datamodules.variants import VARIANTS
from envpred.errors import UserError, check_number
from envpred.interrupts import noted
from envpred.report.paper import paper_page
from envpred.results.names import input_name
from envpred.simulate.commands import simulate
from envpred.store import Store

from .runs.command import run as command
from .runs.command import say
from .study.best import BEST
from .table.execute import execute, show_plan
from .table.job import Job
from .table.plan import check_seeds
from .table.published import FCN_VARIANT, PRESETS, Preset, published_plan
from .tune import tune

CONTEXT = 256  # cells of the wide grid that the rollout reads
STUDIES = {**{f"prednet_{variant}": "prednet" for variant in VARIANTS}, f"fcn_{FCN_VARIANT}": "fcn"}  # -> their space


def paper(
    fit: list[str],
    out: Path = Path("paper"),
    source: Path | None = None,
    preset: Literal["demo", "small", "full"] = "demo",
    trials: int = 0,
    seeds: list[int] = [0],  # noqa: B006 - read only, and the command line shows it
    workers: int = 1,
    circles: bool = True,
    dry_run: bool = False,
) -> None:
    """Make the paper's tables and figures: map, tune if asked to, train, test and write one page.

    Args:
        fit: options of `envpred fit` that go to all that is trained.
        out: folder for grids, studies, runs and the page.
        source: folder with drives; the demo simulates its own.
        preset: demo (two cores, ten minutes), small (one GPU, an evening) or full (the paper's sizes).
        trials: of each study that tunes a network beforehand; 0 takes the preset's hyperparameters.
        seeds: every network is trained with each of them.
        workers: runs at once, which share the processor's cores; small networks use one core best.
        circles: circle the ego and what moves in the forecasts' figure; false for none.
        dry_run: print the plan, and end.
    """
    size = PRESETS[preset]
    if source is None and not size.drives:
        raise UserError(f"--preset {preset} trains on drives of yours; give their folder as --source, or --preset demo")
    check_number("workers", workers, 1)
    check_number("trials", trials)
    check_seeds(seeds)
    drives, store = source or out / "drives", out / "grids"
    if source is None:
        say(f"drives: {size.drives} of {size.frames} frames are simulated in {drives}")
    say(f"grids:  of all drives in {drives}, with velocities and a wide grid, in {store}")
    if trials:
        say(f"tuning: {trials} trials each of {', '.join(STUDIES)}")
    jobs = _jobs(size, fit, {}, seeds, store, out)  # what is wrong with an option is said before an hour's work
    if dry_run:
        for job in jobs:
            say(f"{'train and test' if job.run.trains else 'test'}: {job.run.name}")
        return
    with noted():
        if source is None:
            simulate(drives, drives=size.drives, frames=size.frames)
        grids(store, drives, context=CONTEXT, particle_forecast=["all"])
        if trials:
            tuned = {name: _tuned(name, size, fit, store, out, trials, workers) for name in STUDIES}
            jobs = _jobs(size, fit, tuned, seeds, store, out)
        todo = [job for job in jobs if not job.is_done()]
        failures = execute(todo, show_plan(jobs, todo, [], store, workers), workers)
        if not failures:
            say(f"page: {_page(jobs, store, drives, out, about(preset, trials, source), circles)}")
    if failures:
        raise UserError("\n".join([*failures, f"{len(failures)} of {len(jobs)} runs failed; run the command again"]))


def about(preset: str, trials: int, source: Path | None) -> list[str]:
    """What the page says of how its numbers came about."""
    where = "drives that were simulated with known truth" if source is None else "recorded drives"
    tuned = f"after a study of {trials} trials for each" if trials else "with hyperparameters that were not tuned here"
    return [
        f"Preset {preset}: {where}; networks trained {tuned}, PredNet in two stages (t+1, then t+5), the FCN on "
        f"{input_name(FCN_VARIANT)}. All methods forecast the same windows, each in the ego's grid of the frame. "
        "Standard errors, intervals and tests take the drive as the unit of chance.",
        "The seven drives that the paper tested on are not known by name, so no number here is of its windows: compare "
        "ratios and signs, not levels.",
    ]


def _jobs(size: Preset, fit: list[str], tuned: dict[str, str], seeds: list[int], store: Path, out: Path) -> list[Job]:
    return [Job.of(run, store, out / "runs") for run in published_plan(size, fit, tuned, seeds)]


def _tuned(name: str, size: Preset, fit: list[str], store: Path, out: Path, trials: int, workers: int) -> str:
    """The best configuration of a study, which is gone on with until it has its trials."""
    model, variant = name.split("_", 1)
    config = size.prednet if model == "prednet" else size.fcn
    studies = out / "studies"
    tune(variant, STUDIES[name], store, [f"--config={config}", *fit], trials, studies, name, workers=workers)
    return str(studies / name / BEST)


def _page(jobs: Sequence[Job], store: Path, drives: Path, out: Path, paragraphs: list[str], circles: bool) -> Path:
    """The page, with figures of the first test drive."""
    data = GridDataModule(**jobs[0].config["data"])
    data.setup("test")
    tested = list(dict.fromkeys(place.drive.name for place in data.datasets["test"].places))
    drive = Store(store).drives[tested[0]]
    middle = len(drive.frames) // 2
    figures = {"ground": out / "ground.png", "dogma": out / "dogma.png"}
    for ending in (".pdf", ".png"):
        ground(drives, figures["ground"].with_suffix(ending), drive.name, drive.frames[middle])
        velocity(store, figures["dogma"].with_suffix(ending), drive.name, middle)
    captions = {
        "ground": f"{drive.name}, frame {drive.frames[middle]}: obstacles by the Markov random field and by RANSAC.",
        "dogma": f"{drive.name}, frame {drive.frames[middle]}: velocities of the particle filter.",
    }
    told = {name: (file, captions[name]) for name, file in figures.items()}
    cameras = {name: camera_of(name, drives) for name in tested}
    return paper_page([job.result for job in jobs], out, told, cameras, paragraphs, circles)


def main(args: list[str] | None = None) -> None:
    """Entry point of `envpred paper` and `python -m sweeps.paper`."""
    command(paper, "paper", args)


if __name__ == "__main__":
    main()
