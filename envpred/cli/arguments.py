"""The options of `envpred fit`, read by its own parser: complete configurations, their names, and their mistakes.

Validate, test and predict take the same ones, so what is read here holds for them, too.
"""

from collections.abc import Iterable, Mapping
from typing import Any

import yaml

from envpred.cli.lightning import EnvpredCLI, as_parsed, check_accelerator, lightning
from envpred.cli.tokens import split_arguments
from envpred.errors import UserError, nearest
from envpred.store.files import flat

RUN = ("name", "out")  # where a run lies, which whoever starts many decides


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
        self.parser = lightning(args, _ReadOnly, run=False).parser
        self.base = self.complete({})
        self.values = {_without_init_args(name): value for name, value in flat(self.base).items()}

    def complete(self, arguments: Mapping[str, Any], defaults: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """The complete configuration with `arguments` (dotted name -> value) set, every default spelt out.

        Args:
            arguments: what is set, whatever the command line says.
            defaults: what is set unless the command line says otherwise.

        Raises:
            UserError: as `envpred fit` would refuse them.
        """
        config = self.parser.parse_args(as_parsed([*as_options(defaults or {}), *self.args, *as_options(arguments)]))
        plain: dict[str, Any] = yaml.safe_load(self.parser.dump(config, skip_unset=False))
        return {name: value for name, value in plain.items() if name not in RUN}

    def check_devices(self) -> None:
        """Refuse runs that would not find their devices on this machine.

        Raises:
            UserError: as `envpred fit` would refuse them.
        """
        check_accelerator(self.base["trainer"]["accelerator"])

    def check_names(self, names: Iterable[str], where: str) -> None:
        """Refuse a name that `envpred fit` does not take with this model.

        Raises:
            UserError: naming the nearest right one.
        """
        for name in names:
            if _without_init_args(name) not in self.values:
                near = nearest(name, self.values)
                hint = f"; did you mean {near}?" if near else "; `envpred fit --print_config` lists them all"
                raise UserError(f"{where}: `envpred fit` takes no argument {name} with this model{hint}")


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
