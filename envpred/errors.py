"""The one kind of failure that a user can mend: one line that names the file and the remedy."""


class UserError(Exception):
    """A mistake or a damaged file that the user can mend; the command line prints it without a traceback."""
