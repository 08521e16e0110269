"""What the per-drive jobs share: a progress bar over all of them, and a line for each drive that failed."""

import contextlib
import sys

from tqdm import tqdm

from envpred.build.executors import D, Job, in_processes, on_cluster
from envpred.errors import UserError, check_number


def run_jobs(
    job: Job[D],
    drives: list[D],
    what: str,
    workers: int | None,
    cluster: str | None,
    failures: list[str] | None = None,
) -> int:
    """Run `job` for all drives with a progress bar called `what`; returns the number of frames.

    Raises:
        UserError: with a line for each drive that failed (`failures` are those that had failed before).
    """
    if workers is not None:
        check_number("workers", workers, 1)
    failures = [] if failures is None else failures
    count, before = 0, len(failures)
    with (
        contextlib.closing(on_cluster(job, drives, cluster) if cluster else in_processes(job, drives, workers)) as jobs,
        tqdm(total=sum(len(d.frames) for d in drives), unit="frame", disable=not drives, mininterval=0.5) as bar,
    ):
        bar.set_description("starting workers")
        for frames, failure in jobs:
            if frames:
                if not count:
                    bar.unpause()  # rate and time left are the job's, not the start's
                    bar.set_description(what)
                count += frames
                bar.update(frames)
            if failure:
                failures.append(failure)
    if failures:
        failed = f"{len(failures)} of {before + len(drives)} drives failed; the others are done"
        raise UserError("\n".join([*failures, failed]))
    return count


def say(line: str) -> None:
    """One line on the screen, beside whatever progress bar is there."""
    tqdm.write(line, file=sys.stderr)
