"""Signals where Python, or the end of a program, would make something else of them."""

import signal
import subprocess
import sys

import pytest

SENT = """
import atexit, os, sys, time
from envpred.interrupts import exit_code, leave, raised

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
atexit.register(strike)
print("done")
leave(3)
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
