"""Signals where Python, or the end of a program, would make something else of them."""

import signal
import subprocess
import sys

import pytest

from envpred.interrupts import MESSAGE

SENT = """
import atexit, os, sys, time
from envpred.interrupts import exit_code, program, raised, TWICE

def strike(*_):
    os.kill(os.getpid(), int(sys.argv[1]))
    time.sleep(1)
"""

IGNORED = """
class Finalised:
    __del__ = strike

try:
    with raised():
        Finalised()
        time.sleep(10)
except KeyboardInterrupt as interrupt:
    sys.exit(exit_code(interrupt))
"""

LEFT = """
def main():
    atexit.register(strike)
    print("done")
    sys.exit(3)

program(main)
"""

FAILED = """
def main():
    raise ValueError("a mistake of ours")

program(main)
"""

AGAIN = """
def main():
    try:
        with raised():
            strike()
    except KeyboardInterrupt as interrupt:
        time.sleep(TIMES * TWICE)
        os.kill(os.getpid(), int(sys.argv[1]))
        print("put in order")
        sys.exit(exit_code(interrupt))

program(main)
"""

# A lock of a library's that an exception has left behind, for which the library waits.
STUCK = """
import threading
from envpred import interrupts
interrupts.LONGEST = 0.2
lock = threading.Lock()

def main():
    try:
        with raised():
            lock.acquire()
            try:
                strike()
            finally:
                lock.acquire()
    except KeyboardInterrupt as interrupt:
        sys.exit(exit_code(interrupt))

program(main)
"""

HELD = """
from envpred.interrupts import held

def main():
    try:
        with raised():
            with held():
                strike()
                print("whole")
            print("not reached")
    except KeyboardInterrupt as interrupt:
        sys.exit(exit_code(interrupt))

program(main)
"""


def run(code: str, number: int) -> tuple[int, str, str]:
    done = subprocess.run([sys.executable, "-c", SENT + code, str(number)], capture_output=True, text=True, check=False)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_exception_that_python_ignores_comes_again(number: int) -> None:
    assert run(IGNORED, number) == (128 + number, "", "")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_exit_code_of_what_is_done_stands(number: int) -> None:
    assert run(LEFT, number) == (3, "done\n", "")
    code, _, told = run(FAILED, number)
    assert (code, told.splitlines()[-1]) == (1, "ValueError: a mistake of ours")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_that_comes_twice_is_one_and_one_that_comes_later_ends_at_once(number: int) -> None:
    """As `timeout` sends it, to the process and to its group; and as somebody presses Ctrl-C who cannot wait."""
    assert run(AGAIN.replace("TIMES", "0.0"), number) == (128 + number, "put in order\n", "")
    late = AGAIN.replace("TIMES", "1.1")
    assert run(late, number) == (128 + number, "", f"{MESSAGE}\n")
    # Once the command has said how it ended, nothing more is said.
    told = late.replace("        time.sleep(", "        interrupts.tell('what was saved')\n        time.sleep(")
    assert run("from envpred import interrupts\n" + told, number) == (128 + number, "", "what was saved\n")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_what_waits_for_ever_where_it_is_interrupted_is_ended(number: int) -> None:
    assert run(STUCK, number) == (128 + number, "", f"{MESSAGE}\n")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_short_step_is_whole_before_a_signal_comes(number: int) -> None:
    assert run(HELD, number) == (128 + number, "whole\n", "")
