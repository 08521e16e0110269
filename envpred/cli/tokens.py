"""Command lines as people write them, put as their parsers take them: names of configurations, flags, single names."""

from collections.abc import Collection, Iterator, Sequence

import yaml

from envpred.cli.shipped import find, is_name
from envpred.cli.signatures import Option

CONFIG = ("-c", "--config")
# First parts of the names of the options of `envpred fit`: each is the name itself, or starts with it and a dot.
OPTIONS = ("config", "seed_everything", "trainer", "model", "data", "predictions", "results", "pictures")
ALONE = ("help", "help_all", "print_config", "version")  # options that need no value


def plain(
    args: Sequence[str], known: Sequence[Option], configs: Sequence[str], repeated: Collection[str] = ()
) -> list[str]:
    """`args` with every flag's value written, single names of lists in brackets, and configurations as paths.

    Args:
        args: the command line, without the command.
        known: its options; what is not among them and has no value is taken for a flag.
        configs: kinds of configurations that --config knows by name.
        repeated: options of which each adds its whole value to a list.

    Raises:
        UserError: if a configuration is neither a file nor ships.
    """
    by_name = {option.name: option for option in known}
    done: list[str] = []
    collected: dict[str, list[str]] = {}
    for name, value in pairs(args, {option.name for option in known if option.is_flag}):
        if name is None:
            done.append(value or "")
            continue
        option = by_name.get(name)
        if value is None:
            is_flag = option.is_flag if option else name.rsplit(".", 1)[-1] not in (*ALONE, "config")
            done.append(f"--{name}=true" if is_flag else f"--{name}")
        elif name in repeated:
            collected.setdefault(name, []).append(value)
        elif name == "config":
            done.append(f"--config={find(value, configs) if is_name(value) else value}")
        elif option is not None and option.is_list:
            done.append(f"--{name}={_listed(value, 'str' in option.kind)}")
        else:
            done.append(f"--{name}={value}")
    return [*done, *(f"--{name}={_as_list(values)}" for name, values in collected.items())]


def pairs(args: Sequence[str], flags: Collection[str] = ()) -> Iterator[tuple[str | None, str | None]]:
    """The options of a command line with their values, if they have any; None and the token of what is no option.

    What follows one of the `flags` is its value only if it is true or false.
    """
    rest = list(args)
    while rest:
        token = rest.pop(0)
        if token in CONFIG:
            token = "--config"
        if not token.startswith("--") or token == "--":
            yield None, token
        elif "=" in token:
            name, value = token[2:].split("=", 1)
            yield name, value
        elif rest and _is_value(rest[0], token[2:] in flags):
            yield token[2:], rest.pop(0)
        else:
            yield token[2:], None


def split_arguments(args: list[str], names: Sequence[str] = OPTIONS) -> tuple[list[str], list[str]]:
    """Split a command line into what is none of `envpred fit`'s options, and those of them that `names` names.

    `-c x.yaml` and `--config x.yaml` are both the option `config`; a value stays with the option before it.
    """
    others: list[str] = []
    named: list[str] = []
    for name, value in pairs(args):
        is_named = name is not None and name.split(".", 1)[0].removesuffix("+") in names
        parts = [part for part in (name and f"--{name}", value) if part is not None]
        (named if is_named else others).append("=".join(parts))
    return others, named


def _is_value(token: str, of_flag: bool) -> bool:
    if of_flag:
        return token.lower() in ("true", "false")
    return not token.startswith("--") and token not in CONFIG


def _listed(value: str, is_text: bool) -> str:
    """A list as YAML writes it; single values, and those between commas, need no brackets."""
    if value.startswith("[") or value in ("null", "None"):
        return value
    return _as_list(value.split(",")) if is_text else f"[{value}]"


def _as_list(texts: Sequence[str]) -> str:
    """Texts as a list in YAML, on one line."""
    return yaml.safe_dump(list(texts), default_flow_style=True, width=10**6).strip()
