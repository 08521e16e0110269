"""The command line: Lightning's fit, validate, test and predict, and our own commands in the same style.

    envpred grids --source KITTI --store grids/
    envpred fit --config prednet_small --config dst_static --data.store grids/

Everything is imported where it is needed: help is there at once, worker processes import this module too, and a Ctrl-C
while libraries load is to end like any other.
"""

import sys
from typing import NoReturn

from envpred import interrupts
from envpred.cli.surroundings import check_spelt, current_folder, in_one_line, in_utf8
from envpred.errors import UserError
from envpred.interrupts import MESSAGE, ends_at_once, exit_code, raised, tell


def program() -> NoReturn:
    """What the console script runs."""
    in_utf8()
    interrupts.program(main)


def main(args: list[str] | None = None) -> None:
    """Entry point; a user's mistake is one line on standard error and exit code 1."""
    args = sys.argv[1:] if args is None else args
    try:
        with raised(), in_one_line(args):
            check_spelt(args)
            if (folder := current_folder()) not in sys.path:
                sys.path.append(folder)  # classes of the user's own are named by files in it
            _run(args)
    except UserError as error:
        print(f"envpred: {error}", file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt as interrupt:
        tell(MESSAGE)
        sys.exit(exit_code(interrupt))


def _run(args: list[str]) -> None:
    with ends_at_once():
        from envpred import __version__
        from envpred.cli import help as helps
        from envpred.cli.mistakes import no_command
        from envpred.cli.own import asks_for_help, own
        from envpred.cli.registry import COMMANDS, LIGHTNING

    name, rest = (args[0], args[1:]) if args else ("--help", [])
    if name in ("-h", "--help"):
        print(helps.top().format_help())
    elif name == "--version":
        print(f"envpred {__version__}")
    elif name in COMMANDS:
        own(name, rest)
    elif name not in LIGHTNING:
        raise UserError(no_command(name))
    elif asks_for_help(rest):
        print(helps.of_lightning(name).format_help())
    elif rest == ["--model.help"]:
        print(helps.forecasters())
    else:
        with ends_at_once():
            from envpred.cli.lightning import lightning

            lightning(args)  # what is lost by Ctrl-C is told as soon as there is something to lose
