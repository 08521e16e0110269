"""What the commands of this package share: their command line, failures of one line, and what makes runs comparable."""

import logging
import sys
from collections.abc import Callable, Mapping
from typing import Any

from envpred.cli.help import of_command
from envpred.cli.own import asks_for_help, parsed
from envpred.cli.tokens import split_arguments
from envpred.errors import UserError
from envpred.interrupts import ends_at_once, exit_code, raised

# Arguments of the data that decide which windows are judged; runs that differ here cannot be compared.
FIXED = ("store", "variant", "split", "train", "val", "test", "length", "given", "val_windows", "stride", "movers")


def say(line: str) -> None:
    """One line of what a command has to tell."""
    print(line, flush=True)


def called(name: str) -> str:
    """What a user calls the command `name`."""
    return f"envpred {name}"


def command_line(name: str, options: Mapping[str, Any], fit: list[str]) -> list[str]:
    """What runs the command `name` of these sweeps with `options`, in whatever folder, in a process of its own."""
    given = [f"--{key}={'true' if value is True else value}" for key, value in options.items() if value is not None]
    code = f"from envpred.cli.sweeps import module; module({name!r}).main()"
    return [sys.executable, "-c", code, *given, *fit]


def run(function: Callable[..., None], command: str, args: list[str] | None) -> None:
    """Run `function` as `envpred <command>`; what `envpred fit` takes comes to it as `fit`.

    A user's mistake is one line on standard error and exit code 1, an interruption one line and the signal's code.
    """
    args = sys.argv[1:] if args is None else args
    if asks_for_help(args):
        print(of_command(command).format_help())
        return
    name = called(command)
    logging.getLogger("lightning.pytorch").setLevel(logging.WARNING)  # windows are counted again and again
    try:
        with raised(), ends_at_once():  # `function` says where there is something to lose
            ours, fit = split_arguments(args)
            function(**parsed(command, function, ours, skip=("fit",)), fit=fit)
    except UserError as error:
        print(f"{name}: {error}", file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt as interrupt:
        print(f"{name}: interrupted; run the same command again to go on", file=sys.stderr)
        sys.exit(exit_code(interrupt))
