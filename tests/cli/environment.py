"""Surroundings that the command line is run in by tests: nothing that can be written, small disks, closed pipes."""

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
Result = subprocess.CompletedProcess[str]


def envpred(*args: str | Path, prepare: str = "", package: Path = REPOSITORY, **variables: str) -> Result:
    """`envpred` as a process of its own in the current folder, with environment `variables`; "" takes one away.

    `prepare` is what a shell does first, in a space of mounts of its own.
    """
    command = [sys.executable, "-m", "envpred", *args]
    environment = {**os.environ, "PYTHONPATH": str(package), **variables}
    environment = {name: value for name, value in environment.items() if value or name not in variables}
    if prepare:
        command = [*mounting(f'{prepare}; exec "$@"'), "sh", *command]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=False)


def mounting(script: str) -> Sequence[str | Path]:
    """The beginning of a command that runs `script` where it may mount; tests that cannot are skipped."""
    if subprocess.run(
        ["unshare", "-m", "mount", "--bind", "/proc", "/proc"], capture_output=True, check=False
    ).returncode:
        pytest.skip("only who may mount can take room or rights away from root")
    return ["unshare", "-m", "sh", "-ec", script]


def read_only(*folders: Path) -> str:
    """What a shell does so that nothing in `folders` can be written."""
    return "; ".join(f"mount --bind {folder} {folder}; mount -o remount,bind,ro {folder}" for folder in folders)


def installed(folder: Path) -> Path:
    """A copy of the package in `folder`, as an installation leaves it before anybody has run it."""
    for room in ("envpred", "sweeps", "configs"):
        shutil.copytree(REPOSITORY / room, folder / room, ignore=shutil.ignore_patterns("__pycache__"))
    return folder
