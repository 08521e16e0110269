"""The one kind of failure that a user can mend: one line that names the file and the remedy."""

import contextlib
import difflib
import math
from collections.abc import Iterable, Iterator

VALUE, REASON = 60, 300  # letters of a value, and of a library's reason, that a message repeats


class UserError(Exception):
    """A mistake or a damaged file that the user can mend; the command line prints it without a traceback."""


def check_number(option: str, value: float, least: float = 0, most: float = math.inf, above: bool = False) -> None:
    """Refuse a `value` of `option` that does not lie in `least` ... `most`, or is not `above` the least.

    Raises:
        UserError: naming option, value and range; infinities and what is not a number lie in none.
    """
    if not (math.isfinite(value) and least <= value <= most) or (above and value == least):
        lower = f"above {least:g}" if above else f"of at least {least:g}"
        upper = "" if most == math.inf else f" and at most {most:g}"
        raise UserError(f"--{option} {value:g}: give a number {lower}{upper}")


@contextlib.contextmanager
def as_raised() -> Iterator[None]:
    """Raise the `UserError` of a constructor as it is: jsonargparse makes it one of several reasons of a ValueError."""
    try:
        yield
    except ValueError as error:
        cause = error.__cause__
        while cause is not None and not isinstance(cause, UserError):
            cause = cause.__cause__
        if cause is None:
            raise
        raise cause from None


def nearest(name: str, names: Iterable[str], alike: float = 0.5) -> str | None:
    """The one of `names` that somebody who wrote `name` may have meant; None if none is `alike` (0 to 1) enough."""
    return next(iter(difflib.get_close_matches(name, list(names), 1, alike)), None)


def short(value: object) -> str:
    """A value from a file as a message repeats it: one line, and not for ever."""
    told = ascii(value)
    return told if len(told) <= VALUE else f"{told[:VALUE]}..."


def one_line(error: Exception) -> str:
    """What an error says, as a message repeats it: one line, printable, and not for ever."""
    return printable(str(getattr(error, "strerror", None) or error))


def shown(path: object) -> str:
    """A path that somebody else has named, in printable letters: others may turn a line round, or end it."""
    return "".join(letter if letter.isprintable() else "?" for letter in str(path))


def printable(text: str, longest: int = REASON) -> str:
    """Text in one line of printable letters, the first `longest` of them."""
    return shown(" ".join(text.split()))[:longest]
