"""Ctrl-C where its exception could be lost."""

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

MESSAGE = "envpred: interrupted; run the same command again to go on"


def end_at_once(signum: int, frame: FrameType | None) -> NoReturn:
    """End the process where it stands, as a handler of Ctrl-C."""
    os.write(2, f"{MESSAGE}\n".encode())
    os._exit(130)


@contextmanager
def ends_at_once() -> Iterator[None]:
    """Let Ctrl-C end the process where it stands, for as long as nothing has begun that could be lost.

    A C extension may turn a KeyboardInterrupt that it meets while it loads into an ImportError, or swallow it.
    """
    with _handled(end_at_once):
        yield


_pressed = threading.Event()


@contextmanager
def noted(later: bool = False) -> Iterator[None]:
    """Let Ctrl-C be a KeyboardInterrupt, whatever a library makes of it: what fails after it fails because of it.

    Where an exception at any moment could leave a lock behind, it is one `later`, at the next `heed`; so is SIGTERM.
    """

    def note(signum: int, frame: FrameType | None) -> None:
        _pressed.set()
        if not later:
            raise KeyboardInterrupt

    with _handled(note, *((signal.SIGTERM,) if later else ())):
        _pressed.clear()
        try:
            yield
            if later:
                heed()
        except BaseException:
            if _pressed.is_set():
                raise KeyboardInterrupt from None
            raise
        finally:
            _pressed.clear()


def heed() -> None:
    """Raise the KeyboardInterrupt of a `noted` Ctrl-C again: whoever waits calls this, as it may have been lost.

    Python loses it in finalisers, and in what it calls while a process is started.
    """
    if _pressed.is_set():
        raise KeyboardInterrupt


@contextmanager
def _handled(handler: Callable[[int, FrameType | None], None], *signals: signal.Signals) -> Iterator[None]:
    """Give Ctrl-C, and other `signals`, to a handler."""
    if threading.current_thread() is not threading.main_thread():  # only that one may set signal handlers
        yield
        return
    before = {number: signal.signal(number, handler) for number in (signal.SIGINT, *signals)}
    try:
        yield
    finally:
        for number, other in before.items():
            signal.signal(number, other)
