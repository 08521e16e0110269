"""Kills commands at random moments until they finish, and compares what they leave with what nobody disturbed leaves.

A chain is one command in one folder: started, killed, gone on with, killed again, until it finishes.
"""

import operator
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from envpred.simulate.run import LOCK
from envpred.store.checked import CHECKED
from tests.faults.sessions import heeds, members, send

SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
CODES = {signal.SIGKILL: -9, signal.SIGTERM: 143, signal.SIGINT: 130}
PATIENCE = 60.0  # seconds in which a command ends after a signal; all others work meanwhile, too
ORPHANS = 10.0  # seconds in which its processes end after it
FULL = 900.0  # seconds that a command may take

Options = list[str]


def same(options: Options, work: Path, said: str) -> Options:
    """How most commands are gone on with: by themselves."""
    return options


def nothing(*_: Path) -> None:
    pass


@dataclass(frozen=True)
class Command:
    """A command that takes so long that it is worth to go on with what it had done.

    Args:
        options: of its command line, for the folder of what it reads; what it writes lies in the current folder.
        outcome: all of what it left in a folder that has to be the same whatever happened; it raises AssertionError
            where something is lost or there twice.
        prepare: lays into an empty folder what it changes, from the folder of what it reads.
        go_on: its command line after a kill, from the last one, the folder and what was said on standard error.
        check: what must hold of its folder after every kill.
        alike: whether an outcome is that of a command that nobody disturbed, which comes first.
    """

    options: Callable[[Path], Options]
    outcome: Callable[[Path], object]
    prepare: Callable[[Path, Path], None] = nothing
    go_on: Callable[[Options, Path, str], Options] = same
    check: Callable[[Path], None] = nothing
    alike: Callable[[Any, Any], bool] = operator.eq


@dataclass
class Tally:
    """What was done and found."""

    kills: Counter[tuple[str, str]] = field(default_factory=Counter)  # (command, signal)
    finished: Counter[str] = field(default_factory=Counter)  # compared outcomes of each command
    problems: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        kills = ", ".join(f"{name} {number}: {count}" for (name, number), count in sorted(self.kills.items()))
        return (
            f"{sum(self.kills.values())} kills ({kills}); {dict(self.finished)} compared; {len(self.problems)} problems"
        )


@dataclass
class Chains:
    """Chains of one command.

    Args:
        name: of the command.
        command: the command.
        inputs: folder of what it reads.
        folder: to work in.
        chance: decides moments and signals.
        say: told about each kill and each problem.
    """

    name: str
    command: Command
    inputs: Path
    folder: Path
    chance: random.Random
    say: Callable[[str], None] = print
    tally: Tally = field(default_factory=Tally)
    seconds: float = 0.0
    reference: object = None
    left: set[Path] = field(default_factory=set)  # unfinished when the command was started
    hurried: bool = False  # whether the command was given no time to put anything in order

    @property
    def work(self) -> Path:
        return self.folder / "work"

    def undisturbed(self) -> None:
        """Run the command once without a kill: its outcome and its time are what chains are compared with."""
        self._begin()
        start = time.monotonic()
        process = self._start(self.command.options(self.inputs))
        assert process.wait(FULL) == 0, self._said()
        self.seconds = time.monotonic() - start
        self.reference = self.command.outcome(self.work)
        self.say(f"{self.name}: {self.seconds:.1f} s undisturbed")

    def run(self, signals: list[signal.Signals]) -> Tally:
        """Kill by each of the signals in turn, in as many chains as that takes; the last one is let finish."""
        left = list(signals)
        options = self._begin()
        while left:
            process = self._start(options)
            killed = self._kill(process, left[0])
            self._look_after(process, left[0], killed)
            if killed:
                self.tally.kills[self.name, left.pop(0).name] += 1
                options = self.command.go_on(options, self.work, self._said())
            else:  # faster than the signal
                self._compare(process.returncode)
                options = self._begin()
        self._compare(self._start(options).wait(FULL))
        return self.tally

    def _begin(self) -> Options:
        shutil.rmtree(self.work, ignore_errors=True)
        self.work.mkdir(parents=True)
        self.command.prepare(self.inputs, self.work)
        return self.command.options(self.inputs)

    def _start(self, options: Options) -> subprocess.Popen[bytes]:
        self.left = set(unfinished(self.work))
        with (self.folder / "out").open("wb") as out, (self.folder / "err").open("wb") as err:
            return subprocess.Popen(
                [sys.executable, "-m", "envpred", *options],
                cwd=self.work,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                start_new_session=True,
            )

    def _unfinished(self) -> set[Path]:
        """What the command has begun to write, and neither finished nor removed."""
        return set(unfinished(self.work)) - self.left

    def _said(self) -> str:
        return (self.folder / "err").read_text(errors="replace")

    def _kill(self, process: subprocess.Popen[bytes], number: signal.Signals) -> bool:
        """Kill the command at a random moment; false if it finished before."""
        if not self._wait(process, FULL, lambda: heeds(process.pid)):  # before, a signal is Python's own affair
            return False
        moment = self.chance.choice(("early", "writing", "any"))
        if moment == "early":
            self._wait(process, self.chance.uniform(0, 0.2 * self.seconds))
        elif moment == "any":
            self._wait(process, self.chance.uniform(0, self.seconds))
        else:
            self._wait(process, self.chance.uniform(0, 0.8 * self.seconds))
            if self._wait(process, 0.5 * self.seconds, self._unfinished):
                self._wait(process, self.chance.choice((0.0, 0.002, 0.02, 0.2)) * self.chance.random())
        if process.poll() is not None:
            return False
        whole = number != signal.SIGINT and self.chance.random() < 0.5
        where = sorted(str(path.relative_to(self.work)) for path in self._unfinished())[:3]
        self._send(process, number, whole)
        again = number != signal.SIGKILL and self.chance.random() < 0.25
        self.hurried = again and self.chance.random() < 0.3
        if again:  # as `timeout` does, and who cannot wait
            self._wait(process, self.chance.uniform(1.1, 3) if self.hurried else 0.3 * self.chance.random())
            self._send(process, number, whole)
        try:
            process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            self._problem("left running", f"{PATIENCE:.0f} s after {number.name}")
            for pid in members(process.pid):
                send(pid, signal.SIGKILL)
            process.wait()
            return True
        told = f"{number.name}{' to all' if whole else ''}{' twice' if again else ''}, {moment}"
        self.say(f"{self.name}: {told}, writing {where}: {process.returncode}")
        return process.returncode != 0

    def _send(self, process: subprocess.Popen[bytes], number: signal.Signals, whole: bool) -> None:
        if process.poll() is not None:
            return
        if number == signal.SIGINT:  # as a terminal does
            os.killpg(process.pid, number)
        elif whole:  # as clusters, containers and a lack of memory do
            for pid in members(process.pid):
                send(pid, number)
        else:
            send(process.pid, number)

    def _look_after(self, process: subprocess.Popen[bytes], number: signal.Signals, killed: bool) -> None:
        """What must hold whenever a command has ended."""
        end = time.monotonic() + ORPHANS
        while left := members(process.pid):
            if time.monotonic() > end:
                self._problem("left running", f"{left} of {number.name}")
                for pid in left:
                    send(pid, signal.SIGKILL)
                break
            time.sleep(0.02)
        said = self._said()
        if killed and process.returncode != CODES[number]:
            self._problem("exit code", f"{process.returncode} after {number.name}: {said[-500:]}")
        lines = [line for line in said.splitlines() if "interrupt" in line.lower()]
        if killed and len(lines) != (number != signal.SIGKILL):
            self._problem("lines", f"{lines} after {number.name}")
        logs = {log.name: log.read_text(errors="replace") for log in self.work.rglob("*.log")}
        for name, text in {"standard error": said, **logs}.items():
            if "Traceback" in text:
                self._problem("traceback", f"in {name} after {number.name}: {text[-1500:]}")
        if killed and number != signal.SIGKILL and not self.hurried and (left_over := self._unfinished()):
            self._problem("left over", f"{left_over} after {number.name}")
        try:
            self.command.check(self.work)
        except Exception as error:
            self._problem("broken", f"after {number.name}: {error!r}")

    def _compare(self, code: int) -> None:
        """Compare what a finished command left with what it leaves undisturbed."""
        self.tally.finished[self.name] += 1
        if code != 0:
            self._problem("lost", f"it does not go on, but ends with {code}: {self._said()[-1500:]}")
            return
        if left_over := list(unfinished(self.work)):
            self._problem("left over", f"{left_over} at the end")
        try:
            outcome = self.command.outcome(self.work)
        except Exception as error:
            self._problem("wrong", repr(error))
            return
        if not self.command.alike(self.reference, outcome):
            self._problem("wrong", difference(self.reference, outcome))

    def _problem(self, kind: str, text: str) -> None:
        """Note a problem, and keep the folder that has it."""
        self.tally.problems.append(f"{self.name}: {kind}: {text}")
        kept = self.folder / f"problem-{len(self.tally.problems)}"
        shutil.copytree(self.work, kept, symlinks=True, ignore_dangling_symlinks=True, dirs_exist_ok=True)
        shutil.copy(self.folder / "err", kept / "standard_error")
        self.say(f"PROBLEM {self.tally.problems[-1]} (kept in {kept})")

    def _wait(
        self, process: subprocess.Popen[bytes], seconds: float, condition: Callable[[], object] = lambda: False
    ) -> bool:
        """Wait that long, or until a condition holds (true), or the process ends."""
        end = time.monotonic() + seconds
        while process.poll() is None and time.monotonic() < end:
            if condition():
                return True
            time.sleep(0.001)
        return False


def unfinished(work: Path) -> Iterator[Path]:
    """Files and folders that are being written, or that nobody finished: they are hidden, and no marks that stay."""
    found = (Path(folder, name) for folder, folders, files in os.walk(work) for name in [*folders, *files])
    return (path for path in found if path.name.startswith(".") and not is_mark(path))


def is_mark(path: Path) -> bool:
    """Whether a file may stay wherever it was: a lock, or what a store remembers of files that were compared."""
    return path.name == CHECKED or LOCK in (path.name, path.suffix)


def difference(expected: object, found: object) -> str:
    """What differs, by names where both have names."""
    if isinstance(expected, dict) and isinstance(found, dict):
        names = [name for name in {**expected, **found} if expected.get(name) != found.get(name)]
        return "; ".join(f"{n}: {str(found.get(n))[:200]} instead of {str(expected.get(n))[:200]}" for n in names[:5])
    return f"{str(found)[:500]} instead of {str(expected)[:500]}"
