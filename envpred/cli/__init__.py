"""The command line: Lightning's fit, validate, test and predict, and our own commands in the same style.

    envpred grids --source KITTI --store grids/
    envpred fit --config configs/model/prednet.yaml --config configs/data/dst_static.yaml --data.store grids/

Everything is imported where it is needed: worker processes import this module too, and a Ctrl-C while libraries load
is to end like any other.
"""

import os
import sys
from pathlib import Path

from envpred.errors import UserError
from envpred.interrupts import MESSAGE, ends_at_once


def main(args: list[str] | None = None) -> None:
    """Entry point; a user's mistake is one line on standard error and exit code 1."""
    args = sys.argv[1:] if args is None else args
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())  # classes of the user's own are named by files in the current folder
    try:
        with ends_at_once():
            from envpred.cli.commands import COMMANDS
        if args and args[0] in COMMANDS:
            own(args[0], args[1:])
        else:
            with ends_at_once():
                from envpred.cli.lightning import lightning
            lightning(args)
    except UserError as error:
        print(f"envpred: {error}", file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt:
        print(MESSAGE, file=sys.stderr)
        sys.exit(130)


def own(name: str, args: list[str]) -> None:
    """Run one of our own commands with `args`."""
    # Types of the arguments are read here, which may load torch.
    with ends_at_once():
        from jsonargparse import ArgumentParser

        from envpred.cli.commands import COMMANDS, POSITIONAL

        function = COMMANDS[name]
        parser = ArgumentParser(prog=f"envpred {name}", description=(function.__doc__ or "").splitlines()[0])
        parser.add_argument("--config", action="config", help="Path to a configuration file in YAML.")
        name_of, count = POSITIONAL.get(name, (None, None))
        if name_of is not None:
            parser.add_argument(name_of, nargs=count, type=Path)
        parser.add_function_arguments(function, as_positional=False, skip={name_of} if name_of else None)
        options = parser.instantiate(parser.parse_args(args))
    function(**{key: options[key] for key in vars(options) if key != "config"})
