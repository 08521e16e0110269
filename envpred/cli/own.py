"""Runs our own commands: their functions' arguments are read from the command line."""

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from envpred.cli.help import of_command
from envpred.cli.mistakes import Strict
from envpred.cli.registry import COMMANDS
from envpred.cli.signatures import options
from envpred.cli.sweeps import NAME, module
from envpred.cli.tokens import plain, split_arguments
from envpred.errors import as_raised
from envpred.interrupts import ends_at_once


def own(name: str, args: list[str]) -> None:
    """Run one of our own commands with `args`."""
    if asks_for_help(args):
        print(of_command(name).format_help())
        return
    if COMMANDS[name].function.startswith(NAME):
        with ends_at_once():
            sweeps = module(COMMANDS[name].function.split(".")[1])
        sweeps.main(args)
        return
    with ends_at_once():  # types of the arguments are read here, which may load torch
        room, function = COMMANDS[name].function.rsplit(".", 1)
        run = getattr(import_module(room), function)
        if COMMANDS[name].takes_fit:
            ours, fit = split_arguments(args)
            values = parsed(name, run, ours, skip=("fit",)) | {"fit": fit}
        else:
            values = parsed(name, run, args)
    run(**values)


def parsed(name: str, function: Callable[..., Any], args: list[str], skip: tuple[str, ...] = ()) -> dict[str, Any]:
    """The arguments of a command's `function`, but for those to `skip`, that a command line gives.

    Raises:
        UserError: naming what it does not take.
    """
    command = COMMANDS[name]
    parser = Strict(prog=f"envpred {name}", description=(function.__doc__ or "").splitlines()[0])
    parser.command = name
    parser.add_argument("--config", action="config", help="path to a configuration file in YAML")
    positional, count = command.positional or (None, None)
    if positional is not None:
        kind = function.__annotations__[positional]
        parser.add_argument(positional, nargs=count, type=Path if count else kind)
    skipped: set[str | int] = {*skip, *([positional] if positional else [])}
    parser.add_function_arguments(function, as_positional=False, skip=skipped)
    known = options(command.function, skip=skip)
    tokens = ["--help" if token == "--help_all" else token for token in args]
    given = parser.parse_args(plain(tokens, known, command.configs, command.repeated))
    with as_raised():
        found = parser.instantiate(given)
    return {key: found[key] for key in vars(found) if key != "config"}


def asks_for_help(args: list[str]) -> bool:
    """Whether a command line asks for the help that is there at once."""
    return "-h" in args or "--help" in args
