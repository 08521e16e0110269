"""The same command several times at once on this machine: workers of one study, in processes of their own."""

import os
import signal
import threading
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field

from envpred.errors import UserError

from . import processes
from .command import called, say


def beside(count: int, name: str, command: list[str]) -> None:
    """Run `command`, which is the command `name`, `count` times to the end, each with its share of the cores.

    What they say is said here.  One that fails is told of, and the others go on; Ctrl-C ends them all.

    Raises:
        UserError: if all fail, with their reasons.
    """
    voices = _Voices(f"{called(name)}: ")
    futures: list[Future[str | None]] = []
    failures = []
    with ThreadPoolExecutor(count) as pool:
        try:
            for number in range(count):
                futures.append(pool.submit(_follow, command, processes.threads_each(count), voices, number))
            for left, future in zip(reversed(range(count)), as_completed(futures), strict=True):
                reason = future.result()
                if reason is not None:
                    failures.append(reason)
                    if left:
                        say(f"a worker failed, {left} of {count} still work: {reason}")
        except BaseException:
            processes.abandon(pool, futures)
            raise
    if len(failures) == count:
        raise UserError("\n".join(dict.fromkeys(failures)))


@dataclass
class _Voices:
    """What workers say; what several say alike is said once.  A line that begins with `last` is why one fails."""

    last: str
    first: dict[str, int] = field(default_factory=dict)  # line -> who said it first
    lock: threading.Lock = field(default_factory=threading.Lock)

    def say(self, line: str, number: int) -> None:
        with self.lock:
            if self.first.setdefault(line, number) == number:
                say(line)


def _follow(command: list[str], threads: int, voices: _Voices, number: int) -> str | None:
    """Run the command to its end, and say what it says; its reason if it fails."""
    reading, writing = os.pipe()
    reason, line = "", ""
    with open(reading, encoding="utf-8", errors="replace") as lines:
        with open(writing, "wb") as log:
            process = processes.start(command, log, threads=threads)
        try:
            for line in map(str.rstrip, lines):
                if line.startswith(voices.last):
                    reason = line.removeprefix(voices.last)
                else:
                    voices.say(line, number)
            code = process.wait()
        finally:
            processes.stop(process)
    if code < 0:
        return f"it was ended by signal {-code}" + (" (out of memory?)" if code == -signal.SIGKILL else "")
    return (reason or line or f"exit code {code}") if code else None
