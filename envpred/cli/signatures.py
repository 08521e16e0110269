"""Options of commands, read from the source of their functions and classes without loading it: torch takes seconds."""

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import griffe

from envpred.cli.shipped import PACKAGE

logging.getLogger("griffe").setLevel(logging.ERROR)  # it would warn of docstrings in a style of their own


@dataclass(frozen=True)
class Option:
    """One option of a command.

    Args:
        name: without dashes, dotted where it is part of something.
        kind: its type, as written.
        default: as written; None if it must be given.
        text: what the docstring says of it.
    """

    name: str
    kind: str
    default: str | None
    text: str

    @property
    def is_flag(self) -> bool:
        return self.kind == "bool"

    @property
    def is_list(self) -> bool:
        return "list[" in self.kind

    @property
    def choices(self) -> list[str]:
        """Values of a Literal."""
        kind = self.kind.removesuffix(" | None")
        if not kind.startswith("Literal["):
            return []
        return [part.strip().strip("'\"") for part in kind[len("Literal[") : -1].split(",")]


def options(path: str, prefix: str = "", skip: tuple[str, ...] = ()) -> list[Option]:
    """The options of a function or class of ours, those of its parts that are dataclasses included.

    Args:
        path: module.name.
        prefix: goes before every option's name.
        skip: arguments that are none of the command line's.
    """
    return [
        option
        for part in _parts(path)
        if part.name not in skip
        for option in (
            options(part.within, f"{prefix}{part.name}.")
            if part.within
            else [Option(prefix + part.name, part.kind, part.default, part.text)]
        )
    ]


def summary(path: str) -> str:
    """The first sentence of what a function or class of ours says of itself."""
    doc = _object(path).docstring
    return doc.value.strip().split("\n\n")[0].replace("\n", " ") if doc else ""


def exported(path: str) -> dict[str, str]:
    """The public names of a package of ours, and where each is written."""
    module = _module(_file(path), path)
    return {
        name: m.target_path for name, m in module.members.items() if isinstance(m, griffe.Alias) and name[0].isupper()
    }


@dataclass(frozen=True)
class _Part:
    name: str
    kind: str
    default: str | None
    text: str
    within: str | None  # the dataclass that it is


def _parts(path: str) -> Iterator[_Part]:
    """The arguments of a function or class; a dataclass's are its fields."""
    found = _object(path)
    texts = _texts(found)
    if isinstance(found, griffe.Class) and "__init__" not in found.members:
        entries = [(a.name, a.annotation, a.value) for a in found.attributes.values() if "property" not in a.labels]
    else:
        function = found["__init__"] if isinstance(found, griffe.Class) else found
        entries = [(p.name, p.annotation, p.default) for p in function.parameters if p.name != "self"]
    for name, annotation, default in entries:
        within = annotation.canonical_path if isinstance(annotation, griffe.ExprName) else ""
        is_part = within.startswith("envpred.") and "dataclass" in _object(within).labels
        shown = None if default is None else str(default)
        yield _Part(name, str(annotation), shown, texts.get(name, ""), within if is_part else None)


def _texts(found: griffe.Object) -> dict[str, str]:
    """What a docstring says of each argument."""
    if found.docstring is None:
        return {}
    return {
        argument.name: " ".join(argument.description.split())
        for section in found.docstring.parse("google")
        if section.kind is griffe.DocstringSectionKind.parameters
        for argument in section.value
    }


def _object(path: str) -> griffe.Class | griffe.Function:
    """The function or class at module.name, wherever a package takes it from."""
    module, name = path.rsplit(".", 1)
    found = _module(_file(module), module)[name]
    if isinstance(found, griffe.Alias):
        return _object(found.target_path)
    assert isinstance(found, griffe.Class | griffe.Function)
    return found


@cache
def _module(file: Path, name: str) -> griffe.Module:
    found = griffe.visit(name, file, file.read_text(encoding="utf-8"))
    assert isinstance(found, griffe.Module)
    return found


def _file(module: str) -> Path:
    """The source of a module of ours; that of sweeps lies in the package or beside it."""
    relative = module.replace(".", "/")
    if module.startswith("sweeps"):
        return next(file for place in (PACKAGE, PACKAGE.parent) if (file := place / f"{relative}.py").is_file())
    file = PACKAGE.parent / f"{relative}.py"
    return file if file.is_file() else PACKAGE.parent / relative / "__init__.py"
