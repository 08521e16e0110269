"""The paper's Table I and the switches that the field asks about, as one command: training, test, report.

    envpred ablate --store grids/ --source KITTI --config demo --dry_run
    envpred ablate --store grids/ --source KITTI --config demo --workers 2

Interrupt it whenever you like; the same command goes on, and what is done is not done again.  Options of `envpred fit`
(--config, --model.*, --data.*, --trainer.*) go to every run.
"""

from collections.abc import Sequence
from pathlib import Path

from envpred.cli.arguments import names_configuration
from envpred.datamodules.variants import VARIANTS
from envpred.errors import UserError, check_number
from envpred.interrupts import noted
from envpred.report import report
from envpred.store.files import replace_text

from .runs.command import run as command
from .runs.command import say
from .study.best import BEST
from .study.storage import told
from .table import stores
from .table.execute import execute, show_plan
from .table.job import Job
from .table.plan import QUESTIONS, VELOCITIES, make_plan
from .table.summary import SUMMARY, summary

DEFAULT = "prednet_small"


def ablation(
    store: Path,
    fit: list[str],
    source: Path | None = None,
    out: Path = Path("ablation"),
    tuned: Path | None = None,
    variants: list[str] = list(VARIANTS),  # noqa: B006 - read only, and the command line shows it
    switches: list[str] = list(QUESTIONS),  # noqa: B006
    seeds: list[int] = [0],  # noqa: B006
    workers: int = 1,
    dry_run: bool = False,
) -> None:
    """Make the paper's table and its switches: print the plan, then train, test and report what is not done.

    Args:
        store: folder that `envpred grids` wrote, with velocities.
        fit: options of `envpred fit` that every run starts from; by default the small PredNet's configuration.
        source: folder of the drives; needed by switches that map them in another way.
        out: folder for stores, runs, reports and the summary.
        tuned: folder of studies (`--out` of `envpred tune`); variants with a best.yaml there are run with it, too.
        variants: input variants of the table.
        switches: what is changed one by one, of PredNet or (rollout_...) of the rollout; [] for none.
        seeds: every variant is run with each of them, every switch with the first.
        workers: runs at once, which share the processor's cores; small networks use one core best.
        dry_run: print the plan with an estimate of time, and end.
    """
    check_number("workers", workers, 1)
    if not names_configuration(fit):
        fit = [f"--config={DEFAULT}", *fit]
    best = {v: tuned / f"prednet_{v}" / BEST for v in variants if tuned and (tuned / f"prednet_{v}" / BEST).is_file()}
    if tuned is not None and not best:
        raise UserError(f"{tuned}: holds no prednet_<variant>/{BEST}; run `envpred tune` first, or leave --tuned out")
    plan = make_plan(fit, best, variants, switches, seeds)
    folders = {run.store: stores.folder(run.store, store, out / "stores") for run in plan}
    for key in folders:
        dynamic = any("--data.variant=" + v in run.options for run in plan for v in VARIANTS if "dogma" in v)
        stores.check(key, store, source, dynamic)
    with told(out):
        jobs = [Job.of(run, folders[run.store], out / "runs") for run in plan]
        missing = [key for key, folder in folders.items() if not stores.is_whole(key, folder, store)]
        todo = [job for job in jobs if job.run.store in missing or not job.is_done()]
        times = show_plan(jobs, todo, missing, store, workers)
        if dry_run:
            return
        with noted():
            for key in missing:
                say(f"building the store of {key}")
                stores.build(key, store, folders[key], source)
            failures = execute(todo, times, workers)
            reports = _report(jobs, out, failures)
            text = summary(jobs, reports, failures, out)
            say(f"{text}\nsummary: {replace_text(out / SUMMARY, text)}")
        if failures:
            raise UserError(
                "\n".join(
                    [*failures, f"{len(failures)} of {len(jobs)} runs and their reports failed; the others are done"]
                )
            )


def _report(jobs: Sequence[Job], out: Path, failures: list[str]) -> dict[str, Path]:
    """A report of each group that has results; what cannot be compared is a failure of its own."""
    pages = {}
    for group in dict.fromkeys(group for job in jobs for group in job.run.groups):
        results = [job.result for job in jobs if group in job.run.groups and job.result.is_file()]
        if results:
            try:
                pages[group] = report(results, out / "report" / group, same_inputs=group != VELOCITIES)
            except UserError as error:
                failures.append(f"report {group}: {error}")
    return pages


def main(args: list[str] | None = None) -> None:
    """Entry point of `envpred ablate` and `python -m sweeps.ablation`."""
    command(ablation, "ablate", args)


if __name__ == "__main__":
    main()
