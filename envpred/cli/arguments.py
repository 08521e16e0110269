"""The options of `envpred fit`, read by its own parser: complete configurations, their names, and their mistakes.

Validate, test and predict take the same ones, so what is read here holds for them, too.
"""

import contextlib
import difflib
import io
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import yaml

from envpred.cli.lightning import EnvpredCLI, lightning
from envpred.errors import UserError
from envpred.store.files import flat

# First parts of the names of its options: each is the name itself, or starts with it and a dot.
OPTIONS = ("config", "seed_everything", "trainer", "model", "data", "predictions", "results")


class _ReadOnly(EnvpredCLI):
    """The command line of `envpred fit`, parsed, with nothing built from it."""

    def _parse_ckpt_path(self) -> None:
        pass

    def _set_seed(self) -> None:
        pass

    def before_instantiate_classes(self) -> None:
        pass

    def instantiate_classes(self) -> None:
        pass

    def after_instantiate_classes(self) -> None:
        pass


class FitArguments:
    """A command line of `envpred fit` that runs start from.

    Args:
        args: options as `envpred fit` takes them.

    Raises:
        UserError: as `envpred fit` would refuse them.
    """

    def __init__(self, args: list[str]) -> None:
        self.args = args
        with _one_line():
            self.parser = lightning(args, _ReadOnly, run=False).parser
        self.base = self.complete({})
        self.values = {_without_init_args(name): value for name, value in flat(self.base).items()}

    def complete(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        """The complete configuration with `arguments` (dotted name -> value) set, every default spelt out.

        Raises:
            UserError: as `envpred fit` would refuse them.
        """
        with _one_line():
            config = self.parser.parse_args([*self.args, *as_options(arguments)])
            plain: dict[str, Any] = yaml.safe_load(self.parser.dump(config, skip_unset=False))
        return plain

    def check_names(self, names: Iterable[str], where: str) -> None:
        """Refuse a name that `envpred fit` does not take with this model.

        Raises:
            UserError: naming the nearest right one.
        """
        for name in names:
            if _without_init_args(name) not in self.values:
                near = difflib.get_close_matches(name, self.values, 1, 0.5)
                hint = f"; did you mean {near[0]}?" if near else "; `envpred fit --print_config` lists them all"
                raise UserError(f"{where}: `envpred fit` takes no argument {name} with this model{hint}")


def split_arguments(args: list[str], names: Sequence[str] = OPTIONS) -> tuple[list[str], list[str]]:
    """Split a command line into what is none of `envpred fit`'s options, and those of them that `names` names.

    `-c x.yaml` and `--config x.yaml` are both the option `config`; a value stays with the option before it.
    """
    others: list[str] = []
    named: list[str] = []
    target = others
    for token in args:
        if token.startswith("--") or token == "-c":
            name = "config" if token == "-c" else token[2:].split("=", 1)[0].split(".", 1)[0].removesuffix("+")
            target = named if name in names else others
        target.append(token)
    return others, named


def names_configuration(args: list[str]) -> bool:
    """Whether a command line says which configuration to start from."""
    return bool(split_arguments(args, ("config",))[1])


def as_options(arguments: Mapping[str, Any]) -> list[str]:
    """`arguments` as they are written on the command line."""
    return [f"--{name}={value if isinstance(value, str) else _text(value)}" for name, value in arguments.items()]


def _text(value: Any) -> str:
    text: str = yaml.safe_dump(value, default_flow_style=True, width=10**6)
    return text.removesuffix("\n").removesuffix("\n...")


def _without_init_args(name: str) -> str:
    """A dotted name as it may be given on the command line."""
    return name.replace(".init_args.", ".")


@contextlib.contextmanager
def _one_line() -> Iterator[None]:
    """Turn the parser's way out, usage and all, into its one line."""
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            yield
    except SystemExit:
        lines = [line for line in said.getvalue().splitlines() if line.strip()]
        first = next((n for n, line in enumerate(lines) if "error:" in line), 0)
        text = " ".join(line.strip() for line in lines[first:]).split("error:", 1)[-1].strip()
        inner = re.search(r"Problem with given class_path '[^']*': (.*?) - Expected a <class 'NoneType'>", text)
        raise UserError(inner.group(1).strip() if inner else text) from None
