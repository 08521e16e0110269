"""Ctrl-C, and SIGTERM by which clusters and containers end a job: one line, and an exit code that says which it was."""

import _thread
import atexit
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from threading import Event
from types import FrameType
from typing import NoReturn

MESSAGE = "envpred: interrupted; run the same command again to go on"
SIGNALS = (signal.SIGINT, signal.SIGTERM)
TWICE = 1.0  # seconds in which a signal that comes again is the same one: it is sent to a process and to its group
LONGEST = 30.0  # seconds in which an interrupted command puts itself in order; more hangs, see `_follow`


class Terminated(KeyboardInterrupt):
    """SIGTERM: whatever heeds Ctrl-C heeds it too."""


def exit_code(interrupt: KeyboardInterrupt) -> int:
    """128 and the number of the signal, as shells have it."""
    return 128 + (signal.SIGTERM if isinstance(interrupt, Terminated) else signal.SIGINT)


_since: list[float] = []  # when the first signal was raised
_followed: list[Event] = []  # of each command that is run by `raised`, set at its end
_holding: list[list[int]] = []  # the signals that came, in each step that is `held`


def interrupt(signum: int) -> NoReturn:
    """Raise what stands for a signal."""
    if _followed and not _since:
        _thread.start_new_thread(_follow, (signum, _followed[-1]))  # without a lock that the signal may have met
    _since.append(time.monotonic())
    raise Terminated if signum == signal.SIGTERM else KeyboardInterrupt


def _follow(signum: int, ended: Event) -> None:
    """End a process that does not end by itself.

    An exception that comes while Python enters a `with` may leave a lock of a library's behind, TensorBoard's queue
    say, for which the library then waits for ever.
    """
    if not ended.wait(LONGEST):
        end_at_once(signum, None)


def _raise(signum: int, frame: FrameType | None) -> None:
    """Raise what stands for a signal, as its handler; who presses Ctrl-C again cannot wait for what is put in order."""
    if _holding:
        _holding[-1].append(signum)
        return
    if not _since:
        interrupt(signum)
    if time.monotonic() - _since[0] > TWICE:
        end_at_once(signum, frame)


@contextmanager
def raised() -> Iterator[None]:
    """Let SIGTERM raise an exception, as Ctrl-C does.

    Where Python cannot but ignore an exception (in finalisers, and in what it calls while a process is started), the
    signal comes once more, a moment later, instead of a traceback.
    """
    hook = sys.unraisablehook

    def again(ignored: "sys.UnraisableHookArgs") -> None:
        if not issubclass(ignored.exc_type, KeyboardInterrupt):
            hook(ignored)
            return
        number = exit_code(ignored.exc_type()) - 128
        _since.clear()
        later = threading.Timer(0.05, os.kill, [os.getpid(), number])
        later.daemon = True
        later.start()

    sys.unraisablehook = again
    _since.clear()
    _told.clear()
    _followed.append(Event())
    try:
        with handled(_raise):
            yield
    finally:
        _followed.pop().set()
        sys.unraisablehook = hook


_told: list[str] = []  # the line that says how the command ended, once it is said


def tell(line: str) -> None:
    """Say how the command ended; a signal that comes after it ends the process without another line."""
    with held():
        _told.append(line)
        print(line, file=sys.stderr, flush=True)


def end_at_once(signum: int, frame: FrameType | None) -> NoReturn:
    """End the process where it stands, as a handler of either signal."""
    if not _told:
        os.write(2, f"{MESSAGE}\n".encode())
    os._exit(128 + signum)


@contextmanager
def ends_at_once() -> Iterator[None]:
    """Let either signal end the process where it stands, for as long as nothing has begun that could be lost.

    A C extension may turn a KeyboardInterrupt that it meets while it loads into an ImportError, or swallow it.
    """
    with handled(end_at_once):
        yield


def program(main: Callable[[], None]) -> NoReturn:
    """Run what is all that this process is there for; its exit code stands from its end on.

    While Python takes itself down, there is nothing left to interrupt.  But long before it is done, it gives signals
    back to the kernel, which would end it by them; so all but what others have registered for the end is left out.
    """
    code = 1

    def end(*_: object) -> None:
        with suppress(OSError, ValueError, RuntimeError):  # which Python tells on its own way down
            for stream in (sys.stdout, sys.stderr):
                if stream is not None:  # it is where it was closed
                    stream.flush()
            os._exit(code)

    atexit.register(end)  # the first one is called last
    _give(_raise)
    try:
        main()
        code = 0
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    _give(end)
    sys.exit(code)


_pressed: list[int] = []  # the signals that came while they were `noted`


@contextmanager
def noted(later: bool = False) -> Iterator[None]:
    """Let either signal be an exception, whatever a library makes of it: what fails after it fails because of it.

    Where an exception at any moment could leave a lock behind, it is one `later`, at the next `heed`.
    """

    def note(signum: int, frame: FrameType | None) -> None:
        if not _holding:
            _pressed.append(signum)
        if _holding or not later:
            _raise(signum, frame)

    _since.clear()
    with handled(note):
        _pressed.clear()
        try:
            yield
            heed()
        except BaseException:
            heed()
            raise
        finally:
            _pressed.clear()


def heed() -> None:
    """Raise the exception of a `noted` signal again: whoever waits calls this, as it may have been lost.

    Python loses it in finalisers, and in what it calls while a process is started.
    """
    if _pressed:
        interrupt(_pressed[0])


@contextmanager
def handled(handler: Callable[[int, FrameType | None], object]) -> Iterator[None]:
    """Give both signals to a handler meanwhile."""
    if threading.current_thread() is not threading.main_thread():  # only that one may set signal handlers
        yield
        return
    before = {number: signal.getsignal(number) for number in SIGNALS}
    try:
        with held():  # or one signal would keep the handler that the other has lost
            _give(handler)
        yield
    finally:
        with held():
            for number, other in before.items():
                signal.signal(number, other)


@contextmanager
def held() -> Iterator[None]:
    """Let a signal that is an exception elsewhere come at the end of a short step that must not be left half done."""
    if threading.current_thread() is not threading.main_thread():  # no exception of a signal reaches it
        yield
        return
    came: list[int] = []
    _holding.append(came)
    try:
        yield
    finally:
        _holding.pop()
    if came:
        signal.raise_signal(came[0])


def _give(handler: Callable[[int, FrameType | None], object]) -> None:
    for number in SIGNALS:
        signal.signal(number, handler)
