"""How far ahead: the horizons that are shown one by one, and their names; the time between frames is the data's."""

from collections.abc import Iterable

from envpred.errors import UserError

PERIOD = 0.1  # seconds between frames of KITTI, where nothing tells another
SHOWN_S = (0.1, 0.5, 1.0, 1.5)  # the horizons of the paper's table: logs, pictures and tables show them one by one
NEAR = 0.01  # relative; a period is rounded


def shown_steps(horizons: int, period: float = PERIOD) -> tuple[int, ...]:
    """The steps (1 is the first) that end at `SHOWN_S`; the last step where none does.

    >>> shown_steps(12), shown_steps(30, period=0.05), shown_steps(4, period=1 / 15)
    ((1, 5, 10), (2, 10, 20, 30), (4,))

    Args:
        horizons: number of steps that are forecast.
        period: seconds of a step.
    """
    nearest = [(round(seconds / period), seconds) for seconds in SHOWN_S]
    there = [n for n, seconds in nearest if 1 <= n <= horizons and abs(n * period - seconds) <= NEAR * seconds]
    return tuple(there) or (horizons,)


def asked_steps(seconds: Iterable[float], horizons: int, period: float = PERIOD) -> list[int]:
    """The steps (1 is the first) that end at the times that somebody asks for.

    Args:
        seconds: after the last frame shown.
        horizons: number of steps that are forecast.
        period: seconds of a step.

    Raises:
        UserError: if no step ends there.
    """
    steps = []
    for time in seconds:
        step = round(time / period)
        if abs(step * period - time) > 1e-6 or not 1 <= step <= horizons:
            least, most = (in_seconds(n * period) for n in (1, horizons))
            raise UserError(f"--horizons {time}: give multiples of {least} up to {most}")
        steps.append(step)
    return steps


def in_seconds(seconds: float) -> str:
    """A time as tables and pictures write it, with as many decimals as it needs: `0.5 s`, `0.05 s`."""
    return f"{_decimals(seconds)} s"


def horizon_name(steps: int, period: float = PERIOD) -> str:
    """A horizon of so many steps of `period` seconds, as logs name it.

    >>> horizon_name(5), horizon_name(1, period=0.05)
    ('0.5s', '0.05s')
    """
    return f"{_decimals(steps * period)}s"


def _decimals(seconds: float) -> str:
    """One to three decimals, no zero after the first."""
    text = f"{seconds:.3f}"
    whole = len(text) - 2
    return text[:whole] + text[whole:].rstrip("0")
