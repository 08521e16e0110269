"""Configurations that one subcommand saved, read by another: what only the other takes is left out."""

import inspect
import os
from pathlib import Path
from typing import Any

import yaml
from lightning.pytorch import Trainer

from envpred.cli.registry import LIGHTNING
from envpred.gate import read_yaml

CONFIG = "--config="  # as `envpred.cli.tokens` writes it


def portable(args: list[str]) -> list[str]:
    """A command line of Lightning's whose configurations hold nothing that its subcommand does not take.

    It is written as by `envpred.cli.tokens.plain`.  A run saves its whole configuration, with what Trainer.test or
    Trainer.predict alone takes.  The checkpoint or the weights that were tested go along to every subcommand but `fit`,
    which would go on training them.
    """
    if not args or args[0] not in LIGHTNING:
        return args
    return [args[0], *(_portable(token, args[0]) for token in args[1:])]


def _portable(token: str, subcommand: str) -> str:
    """An option; that of a configuration with its content if something in it is not for `subcommand`."""
    name = token.removeprefix(CONFIG)
    if not token.startswith(CONFIG) or not os.path.isfile(name):
        return token  # its content, or whoever reads it says what is wrong
    content = read_yaml(Path(name), "mend it")
    if not isinstance(content, dict):
        return token
    foreign = {key for key in content if key in _taken_by_any() and key not in _taken(subcommand)}
    if subcommand == "fit" and _saved_by_another(content):
        foreign |= {"ckpt_path", "weights_only", "weights"} & content.keys()
    if not foreign:
        return token
    kept = {key: value for key, value in content.items() if key not in foreign}
    return f"{CONFIG}{yaml.safe_dump(kept, default_flow_style=True, width=10**6)}"


def _taken(subcommand: str) -> set[str]:
    return set(inspect.signature(getattr(Trainer, subcommand)).parameters)


def _taken_by_any() -> set[str]:
    return set().union(*map(_taken, LIGHTNING))


def _saved_by_another(content: dict[str, Any]) -> bool:
    """Whether a configuration was saved by a subcommand other than `fit`."""
    return bool((_taken_by_any() - _taken("fit")) & content.keys())
