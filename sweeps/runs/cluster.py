"""The same command on every worker of a Dask cluster: spread by Dask, without a scheduler of our own."""

import os
import sys
import tempfile
from pathlib import Path

from envpred.build.executors import connect
from envpred.errors import UserError

from . import processes


def on_cluster(address: str, command: list[str]) -> None:
    """Run `command` once on each worker of the Dask scheduler at `address`, to the end.

    A worker that dies takes nothing along but its own part: what it had begun is noticed by the others.

    Raises:
        UserError: if no scheduler answers, it has no workers, or the command fails everywhere.
    """
    client = connect(address)
    import distributed

    with client:
        workers = list(client.scheduler_info(n_workers=-1)["workers"])
        if not workers:
            raise UserError(f"{address}: has no workers yet; start some with `dask worker {address}`")
        tasks = [
            client.submit(attempt, command, os.getcwd(), workers=[worker], pure=False, retries=0) for worker in workers
        ]
        failures = []
        for task, worker in zip(tasks, workers, strict=True):
            try:
                failures += [f"{worker}: {line}" for line in task.result()]
            except distributed.KilledWorker:
                failures.append(f"{worker}: was killed (out of memory?)")
    if len(failures) == len(workers):
        raise UserError("\n".join(failures))


def attempt(command: list[str], folder: str) -> list[str]:
    """Run `command` in `folder` on this machine; its last line if it fails."""
    if not Path(folder).is_dir():
        return [f"does not see {folder}; workers need the folder of the command, shared"]
    with tempfile.TemporaryFile() as log:
        code = processes.start(command, log, folder).wait()
        log.seek(0)
        said = log.read().decode(errors="replace").strip().splitlines()
    sys.stdout.write("\n".join(said) + "\n")
    return [said[-1] if said else f"exit code {code}"] if code else []
