"""Text, JSON, YAML and XML: read, and compared with schemas, see `envpred.gate.stores` and `envpred.gate.runs`."""

import json
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import msgspec
import yaml

from envpred.errors import UserError, one_line, short, shown

HALVES = re.compile(rb"\\u[dD][89a-fA-F]")  # of characters beyond 16 bits, which must come in pairs


def read_text(file: Path, remedy: str) -> str:
    """The text of `file`, which is UTF-8.

    Raises:
        UserError: if it is missing, cannot be read or is no text, with the `remedy`.
    """
    return _text(file, _content(file, remedy), remedy)


def read_json(file: Path, schema: Any, remedy: str, version: int | None = None) -> Any:
    """What stands in `file`, as plain data: beside what the `schema` names it may hold more, which is kept.

    Args:
        file: in JSON.
        schema: a type of `envpred.gate.stores` or `envpred.gate.runs`.
        remedy: what the user is to do if it is refused.
        version: that its `format` must be.

    Raises:
        UserError: naming the file, and what in it is missing, of another type or out of range.
    """
    content = _content(file, remedy)
    try:
        value = json.loads(content)
        if HALVES.search(content):
            json.dumps(value, ensure_ascii=False).encode()
    except (ValueError, RecursionError):
        raise UserError(f"{file}: cannot be read as JSON; {remedy}") from None
    if version is not None and (not isinstance(value, dict) or value.get("format") != version):
        told = value.get("format") if isinstance(value, dict) else None
        raise UserError(f"{file}: format {short(told)}, this version reads {version}; {remedy}")
    conform(value, schema, file, remedy)
    return value


def read_yaml(file: Path, remedy: str) -> Any:
    """What stands in `file`, as plain data.

    Raises:
        UserError: naming the file, and why it cannot be read.
    """
    text = read_text(file, remedy)
    try:
        return yaml.safe_load(text)
    except (ValueError, RecursionError, yaml.YAMLError) as error:
        raise UserError(f"{file}: cannot be read as YAML ({one_line(error)}); {remedy}") from None


def read_xml(file: Path, remedy: str) -> ElementTree.Element:
    """The root of what stands in `file`, which is XML.

    Nothing outside the file is read, and Expat (from 2.4.1 on, with every Python of today) ends what would grow by
    entities of entities.

    Raises:
        UserError: naming the file, and why it cannot be read.
    """
    content = _content(file, remedy)
    try:
        return ElementTree.fromstring(content)
    except (ElementTree.ParseError, ValueError, LookupError) as error:  # the last two of encodings
        raise UserError(f"{file}: cannot be read as XML ({one_line(error)}); {remedy}") from None


def conform(value: Any, schema: Any, file: Path | str, remedy: str, strict: bool = True) -> Any:
    """The plain `value` as an object of the type `schema`; with `strict` False numbers may be texts.

    Raises:
        UserError: naming the `file` it is from, and what in it does not fit.
    """
    try:
        return msgspec.convert(value, schema, strict=strict)
    # SystemError: of 400 digits, up to 0.21; UnicodeError: of text that no file can hold, as a lone surrogate.
    except (msgspec.ValidationError, RecursionError, SystemError, UnicodeError) as error:
        what, _, place = one_line(error).partition(" - at ")
        if " matching regex" in what:
            what = "holds signs that do not belong there"
        where = place.rpartition("$")[2].strip("`").removeprefix(".").replace("[...]", "[]")
        raise UserError(f"{file}: {where + ': ' if where else ''}{what.replace('`', '')}; {remedy}") from None


def _content(file: Path, remedy: str) -> bytes:
    try:
        return file.read_bytes()
    except (FileNotFoundError, UnicodeEncodeError):  # the latter of a name that no file can have
        raise UserError(f"{shown(file)}: missing; {remedy}") from None
    except OSError as error:
        raise UserError(f"{file}: cannot be read ({error.strerror}); {remedy}") from None


def _text(file: Path, content: bytes, remedy: str) -> str:
    try:
        return content.decode()
    except UnicodeDecodeError:
        raise UserError(f"{file}: is no text; {remedy}") from None
