"""What a parser says of a mistake, as one line that names the option, and the nearest right one."""

import re
from collections.abc import Iterable
from typing import Any

from jsonargparse import ArgumentParser

from envpred.cli.help import MODELS, known
from envpred.cli.registry import COMMANDS, LIGHTNING
from envpred.cli.signatures import exported, options
from envpred.errors import UserError, nearest, one_line, printable

OTHER = re.compile(r"unrecognized arguments: (.*)")
NO_OPTION = re.compile(r"Problem with given class_path '([\w.]+)':\s+Option '(\w+)' is not accepted")
NO_CLASS = re.compile(r'Parser key "model":.*?(?:Expected a dot import path string:|No module named) ', re.DOTALL)
INNER = re.compile(
    r'Parser key "(\w+)":\s+(?:Problem|Does not validate).*?Parser key "(\w+)":\s+(.*?)\s+- Expected a <class',
    re.DOTALL,
)
OF_KEY = re.compile(r'Parser key "([\w.]+)":\s+(.*)', re.DOTALL)
LONGEST = 900  # letters of a line
NEEDED = re.compile(r"required: (.*)")
CLASS = re.compile(r"<class '(?:\w+\.)*(\w+)'>")


class Strict(ArgumentParser):
    """A parser that takes no option for another one, and whose mistakes are a user's, in one line."""

    command = ""  # whose options it parses

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **{"allow_abbrev": False, **kwargs})

    def parse_args(self, *args: Any, **kwargs: Any) -> Any:
        try:
            return super().parse_args(*args, **kwargs)
        except (UnicodeDecodeError, OSError, RecursionError) as error:
            raise UserError(
                f"a configuration names a file that holds none ({one_line(error)}); give values or files in YAML"
            ) from None

    def error(self, message: str, ex: Exception | None = None) -> Any:
        if not self.exit_on_error:  # one parser asks another whether it would take something
            return super().error(message, ex)
        raise UserError(printable(explained(message, self.command), LONGEST)) from None


def explained(message: str, command: str) -> str:
    """One line for what jsonargparse says of a command line of `command`."""
    for pattern, said in (
        (OTHER, _other),
        (NO_OPTION, _no_option),
        (NO_CLASS, _no_class),
        (NEEDED, _needed),
        (INNER, _inner),
        (OF_KEY, _of_key),
    ):
        if found := pattern.search(message):
            return " ".join(CLASS.sub(r"\1", said(found, command)).split())
    return " ".join(message.split())


def _other(found: re.Match[str], command: str) -> str:
    token = found[1].split()[0].split("=")[0]
    kind, name = "option" if token.startswith("-") else "argument", token.lstrip("-")
    if command in COMMANDS and name == (COMMANDS[command].positional or ("",))[0]:
        return f"there is no option {token}; give its value alone, as `envpred {command} --help` shows"
    hint = meant(name, known(command), "--") or _listed(command)
    return f"there is no {kind} {token}{hint}"


def _no_option(found: re.Match[str], command: str) -> str:
    of_class = found[1].rsplit(".", 1)[-1]
    ours = exported(MODELS).get(of_class)
    names = [option.name for option in options(ours, "model.")] if ours else []
    hint = meant(f"model.{found[2]}", names, "--") or f"; `envpred {command} --model.help {of_class}` lists them"
    return f"{of_class} has no option {found[2]}{hint}"


def _no_class(found: re.Match[str], command: str) -> str:
    given = found.string.rsplit("Given value: ", 1)[-1].strip()
    hint = meant(given, exported(MODELS)) or f"; `envpred {command} --model.help` lists ours"
    return f"--model {given}: no forecaster of ours, nor a class in a file of the current folder{hint}"


def _needed(found: re.Match[str], command: str) -> str:
    needed = " ".join("--" + key.strip().removeprefix(f"{command}.") for key in found[1].split(","))
    return f"{needed} must be given{_listed(command)}"


def _inner(found: re.Match[str], command: str) -> str:
    return f"--{found[1]}.{found[2]}: {found[3]}"


def _of_key(found: re.Match[str], command: str) -> str:
    return f"--{found[1]}: {found[2]}"


def no_command(name: str) -> str:
    """One line for a command that there is none of."""
    hint = meant(name, [*LIGHTNING, *COMMANDS])
    return f"there is no command {name}{hint or '; `envpred --help` lists them'}"


def meant(name: str, names: Iterable[str], dashes: str = "") -> str:
    """The end of a line that names the nearest of `names`; empty if none is near."""
    near = nearest(name, names, 0.6)
    return f"; did you mean {dashes}{near}?" if near else ""


def _listed(command: str) -> str:
    return f"; `envpred {command} --help` lists its options"
