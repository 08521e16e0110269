"""Ctrl-C where its exception could be lost."""

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import NoReturn

MESSAGE = "envpred: interrupted; run the same command again to go on"


@contextmanager
def ends_at_once() -> Iterator[None]:
    """Let Ctrl-C end the process where it stands, for as long as nothing has begun that could be lost.

    A C extension may turn a KeyboardInterrupt that it meets while it loads into an ImportError, or swallow it.
    """

    def end(signum: int, frame: FrameType | None) -> NoReturn:
        os.write(2, f"{MESSAGE}\n".encode())
        os._exit(130)

    if threading.current_thread() is not threading.main_thread():  # only that one may set signal handlers
        yield
        return
    before = signal.signal(signal.SIGINT, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@dataclass
class Interrupt:
    """Whether Ctrl-C was pressed."""

    told: bool = False


@contextmanager
def noted() -> Iterator[Interrupt]:
    """Let Ctrl-C be a KeyboardInterrupt, as ever, and be known also where a library makes something else of that."""
    interrupt = Interrupt()

    def note(signum: int, frame: FrameType | None) -> NoReturn:
        interrupt.told = True
        raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield interrupt
        return
    before = signal.signal(signal.SIGINT, note)
    try:
        yield interrupt
    finally:
        signal.signal(signal.SIGINT, before)
