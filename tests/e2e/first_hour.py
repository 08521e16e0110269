"""The first hour of a user, from a wheel in a fresh environment to a report: a transcript, and what each command took.

    python -m tests.e2e.first_hour FOLDER [--installed BIN]

The commands of the README and of the pages are read from them and run in their order; trainings are cut short, by
options that the transcript shows.  Without --installed, a wheel is built and installed with all that it needs into
FOLDER/environment.
"""

import argparse
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from tests.drives.synthetic import motion, scans, write_sequence

REPOSITORY = Path(__file__).resolve().parents[2]
SHORT = {  # what is added to commands, by what they begin with
    "envpred fit --config prednet_small": "--data.samples 20 --model.t1_epochs 1 --model.t5_epochs 1",
    "envpred fit --config studies": "--data.samples 20",
    "envpred fit --config corrected_rollout": "--data.samples 4 --model.max_epochs 1",
    "envpred tune": "--trials 3 --space prednet_schedule --data.samples 10 --model.t1_epochs 1 --model.t5_epochs 1",
}
SECTIONS = (
    ("README.md", "Forecast your own drives"),
    ("docs/forecast.md", "Forecast your drives"),
    ("docs/sweeps.md", "Tune and ablate"),
)
LIMIT_SECONDS = 900


@dataclass
class Hour:
    """Runs commands in a folder, prints them with what they say, and keeps what they took.

    Args:
        folder: where a user works.
        programs: folder of the environment's programs.
    """

    folder: Path
    programs: Path
    took: list[tuple[str, float]] = field(default_factory=list)

    def run(self, command: str, fails: bool = False) -> str:
        """Run a command as a shell would; returns what it says."""
        outside = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "PYTHONHOME")}
        outside["PATH"] = f"{self.programs}:{outside['PATH']}"
        print(f"$ {command}", flush=True)
        start = time.perf_counter()
        done = subprocess.run(
            command,
            shell=True,
            cwd=self.folder,
            env=outside,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            timeout=LIMIT_SECONDS,
            check=False,
        )
        self.took.append((command, time.perf_counter() - start))
        said = as_seen(done.stdout)
        print(f"{said}\n", flush=True)
        if (done.returncode != 0) != fails or "Traceback" in said:
            raise RuntimeError(f"{command}: exit code {done.returncode}\n{said}")
        return said

    def table(self) -> str:
        """The seconds of each command, as Markdown."""
        rows = [f"| `{command}` | {seconds:.1f} |" for command, seconds in self.took]
        return "\n".join(["| command | s |", "|---|---|", *rows])


def as_seen(output: bytes) -> str:
    """What a terminal shows in the end: of a line that is written again and again, the last."""
    lines = (
        line.replace("\x1b[A", "").rstrip("\r").rsplit("\r", 1)[-1].rstrip() for line in output.decode().split("\n")
    )
    return "\n".join(line for line in lines if line)


def commands_of(page: str, section: str) -> Iterator[str]:
    """The commands of the blocks of a section of a page, cut short where they train."""
    text = (REPOSITORY / page).read_text(encoding="utf-8")
    _, text = re.split(rf"^#+ {re.escape(section)}$", text, maxsplit=1, flags=re.MULTILINE)
    text = re.split(r"^#+ ", text, maxsplit=1, flags=re.MULTILINE)[0]
    for language, block in re.findall(r"^```(\w*)\n(.*?)^```$", text, re.DOTALL | re.MULTILINE):
        for line in ("" if language else block).replace("\\\n", "").splitlines():
            command = " ".join(line.split("  #")[0].replace("KITTI_ROOT", "drives").split())
            if command.startswith("envpred"):
                added = next((more for start, more in SHORT.items() if command.startswith(start)), "")
                yield f"{command} {added}".strip()


def first_hour(folder: Path, installed: Path | None = None) -> Hour:
    """Go through the first hour in `folder`, with an environment that has envpred or a fresh one."""
    work = folder / "work"
    work.mkdir(parents=True)
    hour = Hour(work, installed or folder / "environment" / "bin")
    if installed is None:
        _install(hour, folder)
    _look_around(hour)
    hour.run("envpred simulate drives --drives 4 --frames 60 --seed 0")
    for page, section in SECTIONS[:2]:
        for command in commands_of(page, section):
            hour.run(command)
    hour.run("tensorboard --logdir runs/fit --inspect --tag val/mse")
    _forecast(hour)
    for command in commands_of(*SECTIONS[2]):
        hour.run(command)
    _bring_ones_own(hour)
    return hour


def _install(hour: Hour, folder: Path) -> None:
    """A wheel, in an environment of its own."""
    wheels, python = shlex.quote(str(folder / "wheels")), shlex.quote(sys.executable)
    source = shlex.quote(str(REPOSITORY))
    hour.run(f"{python} -m pip wheel --quiet --no-deps --wheel-dir {wheels} {source}")
    hour.run(f"{python} -m venv {shlex.quote(str(folder / 'environment'))}")
    hour.run(f"pip install --quiet --constraint {source}/constraints.txt {wheels}/*.whl")


def _look_around(hour: Hour) -> None:
    """Help, names, and what a slip of the hand says."""
    for command in ("envpred --help", "envpred fit --help", "envpred test --help", "envpred predict --help"):
        hour.run(command)
    for command in ("envpred fit --model.help", "envpred configs", "envpred grids --help", "envpred --version"):
        hour.run(command)
    hour.run("envpred gird --store grids", fails=True)
    hour.run("envpred fit --config prednet_smal --data.store grids", fails=True)
    hour.run("envpred fit --config prednet_small --data.store grids", fails=True)


def _forecast(hour: Hour) -> None:
    """What random weights get, forecasts of the newest frames, and pictures."""
    hour.run("envpred test --config prednet_small --data.store grids", fails=True)
    newest = "--data.predict newest --ckpt_path best --predictions.folder newest"
    hour.run(f"envpred predict --config prednet_small --data.store grids {newest}")
    hour.run("envpred draw newest --store grids --out strip.png")
    hour.run("envpred show --store grids --frame 20 --out mapping.png")
    hour.run("envpred verify --store grids")


def _bring_ones_own(hour: Hour) -> None:
    """Drives in another layout, drives behind a reader of one's own, and a forecaster of one's own."""
    write_sequence(hour.folder / "odometry", frames=60)
    hour.run("envpred grids --source odometry --store sequences --context 256 --dogma")
    mine = hour.folder / "numpy" / "mine"
    mine.mkdir(parents=True)
    _write_numpy(mine)
    for example in ("reader.py", "forecaster.py"):
        shutil.copy(REPOSITORY / "examples" / example, hour.folder)
    hour.run("envpred grids --reader reader.find --source numpy --store own --context 256 --dogma")
    own = "--model forecaster.ContextForecaster --data.store own --data.samples 5 --out own_runs"
    hour.run(f"envpred fit {own} --trainer.max_epochs 2 --data.train mine@-24 --data.val mine@24-46 --name first")
    hour.run(f"envpred test {own} --data.train mine@-20 --data.val mine@20-40 --data.test mine@40- --ckpt_path best")
    hour.run("envpred test --config last_frame --data.store own --data.test mine@40- --out own_runs")
    hour.run("envpred report own_runs/test --out own_report")


def _write_numpy(folder: Path) -> None:
    """A drive as the example's reader takes it."""
    import numpy as np

    poses = motion(60, 5.0, 0.0, 0.0)
    np.save(folder / "poses.npy", poses)
    for k, points in enumerate(scans(poses)):
        np.save(folder / f"{k}.npy", points)


def main() -> None:
    """Run the hour, and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--installed", type=Path, help="folder of programs that holds an envpred already")
    arguments = parser.parse_args()
    print(first_hour(arguments.folder.resolve(), arguments.installed).table())


if __name__ == "__main__":
    main()
