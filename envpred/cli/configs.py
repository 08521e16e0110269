"""Configurations that one subcommand saved, read by another: what only the other takes is left out."""

import inspect
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml
from lightning.pytorch import Trainer

from envpred.cli.registry import LIGHTNING
from envpred.cli.tokens import CONFIG
from envpred.gate import read_yaml


def portable(args: list[str]) -> list[str]:
    """A command line of Lightning's whose configurations hold nothing that its subcommand does not take.

    A run saves its whole configuration, with what Trainer.test or Trainer.predict alone takes.  The checkpoint that was
    tested goes along to every subcommand but `fit`, which would go on training it.
    """
    if not args or args[0] not in LIGHTNING:
        return args
    return [args[0], *(_portable(token, args[0]) if is_file else token for token, is_file in _tokens(args[1:]))]


def _tokens(args: list[str]) -> Iterator[tuple[str, bool]]:
    """The tokens of a command line, and whether each is, or ends in, the name of a configuration."""
    before = ""
    for token in args:
        yield token, before in CONFIG or token.startswith("--config=")
        before = token


def _portable(token: str, subcommand: str) -> str:
    """A configuration's name, or its content if something in it is not for `subcommand`."""
    option, equals, name = token.rpartition("=") if token.startswith("--config=") else ("", "", token)
    if not os.path.isfile(name):
        return token  # its content, or whoever reads it says what is wrong
    content = read_yaml(Path(name), "mend it")
    if not isinstance(content, dict):
        return token
    foreign = {key for key in content if key in _taken_by_any() and key not in _taken(subcommand)}
    if subcommand == "fit" and _saved_by_another(content):
        foreign |= {"ckpt_path", "weights_only"} & content.keys()
    if not foreign:
        return token
    kept = {key: value for key, value in content.items() if key not in foreign}
    return f"{option}{equals}{yaml.safe_dump(kept, default_flow_style=True, width=10**6)}"


def _taken(subcommand: str) -> set[str]:
    return set(inspect.signature(getattr(Trainer, subcommand)).parameters)


def _taken_by_any() -> set[str]:
    return set().union(*map(_taken, LIGHTNING))


def _saved_by_another(content: dict[str, Any]) -> bool:
    """Whether a configuration was saved by a subcommand other than `fit`."""
    return bool((_taken_by_any() - _taken("fit")) & content.keys())
