"""The runs of a plan, one after the other or several at once: the plan first, with an estimate of time."""

import math
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import torch

from envpred.datamodules import GridDataModule
from envpred.store import Store

from ..runs import processes
from ..runs.command import say
from ..runs.trial import TrialFailedError
from .estimate import seconds, untrained
from .job import Job

GRIDS_A_SECOND = 30.0  # frames mapped, with velocities, on one core; for the estimate alone


def show_plan(
    jobs: Sequence[Job], todo: Sequence[Job], missing: Sequence[str], store: Path, workers: int
) -> dict[str, float]:
    """Print the plan; returns the estimated seconds of each run that is to do, by its name."""
    if workers > 1:
        torch.set_num_threads(processes.threads_each(workers))  # what is timed here has as many as the runs will have
    example = GridDataModule(**{**jobs[0].config["data"], "store": store})
    example.setup("fit")
    sizes = example.cells, example.horizons, len(example.datasets["val"])
    frames = sum(len(drive.frames) for drive in Store(store).drives.values())
    times = {job.run.name: seconds(job.config, *sizes) if job.run.trains else untrained(sizes[-1]) for job in todo}
    width = max(len(job.run.name) for job in jobs)
    for key in missing:
        say(f"{'store ' + key:{width}}  {_span(frames / GRIDS_A_SECOND):>8}  {frames} frames to map")
    for job in jobs:
        state = _span(times[job.run.name]) if job in todo else "done"
        say(f"{job.run.name:{width}}  {state:>8}  reports: {', '.join(job.run.groups)}")
    total = sum(times.values()) / workers + len(missing) * frames / GRIDS_A_SECOND
    say(f"{len(todo)} of {len(jobs)} runs and {len(missing)} stores to do, about {_span(total)}")
    return times


def execute(todo: Sequence[Job], times: dict[str, float], workers: int) -> list[str]:
    """Run what is to do; returns a line for each run that failed."""
    failures = []
    start, planned = time.monotonic(), 0.0
    for place, (job, failure) in enumerate(outcomes(todo, workers), 1):
        if failure is not None:
            failures.append(f"{job.run.name}: {failure} (see the logs in {job.folder})")
        planned += times.pop(job.run.name)
        left = sum(times.values()) * (time.monotonic() - start) / planned
        said = "done" if failure is None else "failed"
        say(f"{place} of {len(todo)}: {job.run.name} {said}; about {_span(left)} left")
    return failures


def outcomes(todo: Sequence[Job], workers: int) -> Iterator[tuple[Job, TrialFailedError | None]]:
    """Do the jobs, `workers` at once; gives each as it ends, with its failure if it failed."""
    if workers == 1:
        yield from map(_outcome, todo)
        return
    with ThreadPoolExecutor(workers) as pool:
        futures = [pool.submit(_outcome, replace(job, threads=processes.threads_each(workers))) for job in todo]
        try:
            for future in as_completed(futures):
                yield future.result()
        except BaseException:  # of a run, or Ctrl-C: nothing more is started, and what runs is ended
            processes.abandon(pool, futures)
            raise


def _outcome(job: Job) -> tuple[Job, TrialFailedError | None]:
    try:
        job.do()
    except TrialFailedError as failed:
        return job, failed
    return job, None


def _span(value: float) -> str:
    return str(timedelta(seconds=math.ceil(value)))
