"""Completion of command lines by the shell, for all commands, written once as a script that loads nothing."""

from argparse import ArgumentParser, _SubParsersAction
from typing import Literal

import shtab

from envpred.cli.help import of_command, of_lightning
from envpred.cli.registry import COMMANDS, LIGHTNING
from envpred.cli.shipped import COMPLETE, names
from envpred.gate.weights import shipped


def completion(shell: Literal["bash", "zsh", "tcsh"]) -> None:
    """Print a script that lets a shell complete commands, options, names of configurations, and files.

    Args:
        shell: bash, zsh or tcsh: put `eval "$(envpred completion bash)"` into its start-up file.
    """
    print(script(shell))


def script(shell: str) -> str:
    """The completion script of a shell."""
    parser = ArgumentParser(prog="envpred", description="occupancy forecasts")
    commands = parser.add_subparsers(dest="command")
    for name, text in LIGHTNING.items():
        _add(commands, name, of_lightning(name), text, COMPLETE)
    for name, command in COMMANDS.items():
        _add(commands, name, of_command(name), "", command.configs)
    return shtab.complete(parser, shell)


def _add(
    commands: "_SubParsersAction[ArgumentParser]", name: str, shown: ArgumentParser, text: str, configs: tuple[str, ...]
) -> None:
    """Add a command's parser: values that are configurations by their names, others as files."""
    for action in shown._actions:
        if action.dest in ("config", "space"):
            kinds = configs if action.dest == "config" else ("space",)
            action.choices = [short for kind in kinds for short in names(kind)]
        elif action.dest == "weights":
            action.choices = list(shipped())
        elif action.nargs != 0 and action.choices is None:
            action.complete = shtab.FILE  # type: ignore[attr-defined]
    commands.add_parser(name, parents=[shown], add_help=False, help=text or shown.description)
