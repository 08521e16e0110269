"""What messages of `UserError` tell the user to do, read out of their text, for tests that do it."""

import contextlib
import io
import re
import shlex
from importlib.metadata import requires

import pytest
from packaging.requirements import Requirement

from envpred.cli import main
from envpred.errors import UserError

# What may follow an option that is named without a value.
_WORDS = "or|and|to|as|for|with|if|of|in|out|at|on|nor|cannot"
_VALUE = rf"'[^']*'|(?!(?:{_WORDS})\b)[\w./\[\]@-]*[\w/\]]"
_NAMED = re.compile(
    rf"`((?:envpred|python|dask) [^`]+)`|\b(pip install '[^']+')|(?<!\S)\(?(--[a-z][\w.]*(?:[ =](?:{_VALUE}))?)"
)


def commands(text: str) -> list[list[str]]:
    """The commands and options in the remedy of a message, each as a shell would hand it on, without `envpred`.

    The remedy follows the last semicolon, or else the first colon.
    """
    remedy = text.rpartition("; ")[2] if "; " in text else text.partition(": ")[2]
    return [shlex.split("".join(found).removeprefix("envpred ")) for found in _NAMED.findall(remedy)]


def remedy(said: object) -> list[list[str]]:
    """The `commands` of the message with which `said` ends, for whoever runs them: the record says that they are."""
    from tests.user_errors import Recorder

    made = {message: source for message, source in Recorder.current.made.items() if message in str(said)}
    message = max((message for message in made if str(said).strip().endswith(message)), key=len)
    for inner, source in made.items():
        if commands(inner) == commands(message):
            Recorder.current.tell("run", source)
    return commands(message)


def refusal(args: list[str]) -> str:
    """What `envpred` says when it refuses `args`."""
    said = io.StringIO()
    with contextlib.redirect_stderr(said), pytest.raises(SystemExit) as stop:
        main(args)
    assert stop.value.code == 1
    assert "\nTraceback" not in said.getvalue()
    return said.getvalue()[said.getvalue().index("envpred: ") :].strip().removeprefix("envpred: ")


def command(*args: str) -> None:
    """Run a command; what it refuses is raised as it was said."""
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            main(list(args))
    except SystemExit as end:
        if end.code not in (0, None):
            raise UserError(said.getvalue().strip()) from None


def installs(command: list[str]) -> set[str]:
    """Names of the packages that `pip install 'envpred[extra]'` brings beside those that envpred always needs."""
    assert command[:2] == ["pip", "install"]
    asked = Requirement(command[2])
    found = [Requirement(line) for line in requires(asked.name) or ()]
    return {r.name for r in found if r.marker and any(r.marker.evaluate({"extra": extra}) for extra in asked.extras)}
