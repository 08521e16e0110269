"""The one kind of failure that a user can mend: one line that names the file and the remedy."""

import contextlib
from collections.abc import Iterator


class UserError(Exception):
    """A mistake or a damaged file that the user can mend; the command line prints it without a traceback."""


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
