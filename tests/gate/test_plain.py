"""Text, JSON and YAML that is not what its schema says is refused in one line that names file, place and remedy."""

from pathlib import Path
from typing import Any

import pytest
from msgspec import Struct

from envpred.errors import UserError, one_line
from envpred.gate import conform, read_json, read_text, read_yaml
from envpred.gate.types import Cells, Count, Key, Line, Number, Place


class Part(Struct):
    count: Count


class Whole(Struct):
    name: Line
    parts: dict[Key, list[Part]]

    def __post_init__(self) -> None:
        if self.name in self.parts:
            raise ValueError("the name is that of a part")


def test_what_the_schema_does_not_name_is_kept(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text('{"format": 3, "name": "é\\ud83d\\ude00", "parts": {}, "more": [1, null]}')
    told = read_json(tmp_path / "a.json", Whole, "mend it", 3)
    assert told == {"format": 3, "name": "é\U0001f600", "parts": {}, "more": [1, None]}


REFUSED = {
    '{"name": "a", "parts": {}}': "format None, this version reads 3",
    "[1, 2]": "format None, this version reads 3",
    '{"format": "' + "x" * 999 + '"}': "format 'x{59}\\.\\.\\., this version reads 3",
    '{"format": 3, "name": "a"}': "Object missing required field parts",
    '{"format": 3, "name": "a", "parts": {"b": [{"count": 1}, {"count": -1}]}}': r"parts\[\]\[1\]\.count: Expected .*",
    '{"format": 3, "name": "a", "parts": {"b": [{"count": true}]}}': r"parts\[\]\[0\]\.count: Expected int, got bool",
    '{"format": 3, "name": "a", "parts": {"../b": []}}': "parts.*: holds signs that do not belong there",
    '{"format": 3, "name": "a\\nb", "parts": {}}': "name: holds signs that do not belong there",
    '{"format": 3, "name": "a", "parts": {"a": []}}': "the name is that of a part",
    '{"format": 3, "name": "\\ud800", "parts": {}}': "cannot be read as JSON",
    '{"format": 3, "name": ' + "[" * 100_000: "cannot be read as JSON",
    '{"format": ' + "1" * 5000 + "}": "cannot be read as JSON",
    "": "cannot be read as JSON",
}


@pytest.mark.parametrize("text", REFUSED, ids=lambda text: text[:70])
def test_what_does_not_fit_is_named(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(UserError, match=rf"a\.json: {REFUSED[text]}; mend it") as refusal:
        read_json(tmp_path / "a.json", Whole, "mend it", 3)
    assert str(refusal.value).isprintable()


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 10**400, "1", None, True])
def test_a_number_is_one(value: Any) -> None:
    with pytest.raises(UserError, match="there: "):
        conform(value, Number, "there", "mend it")


@pytest.mark.parametrize(("value", "schema"), [(7, Cells), (10**30, Cells), ("..\0", Place), ("", Place), (".a", Key)])
def test_types_have_bounds(value: Any, schema: Any) -> None:
    with pytest.raises(UserError, match="there: "):
        conform(value, schema, "there", "mend it")


def test_files_that_cannot_be_read_are_one_line(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "binary").write_bytes(b"\xff\x00")
    (tmp_path / "list.yaml").write_text("a: [1,\n  {")
    for name, reason in (("gone", "missing"), ("folder", "cannot be read .Is a directory."), ("binary", "is no text")):
        with pytest.raises(UserError, match=f"{name}: {reason}; copy it again"):
            read_text(tmp_path / name, "copy it again")
    with pytest.raises(UserError, match=r"list\.yaml: cannot be read as YAML \(.+\); mend it") as refusal:
        read_yaml(tmp_path / "list.yaml", "mend it")
    assert str(refusal.value).isprintable()


def test_reasons_are_one_printable_line() -> None:
    assert one_line(ValueError("a\n  b\x1b[2J\x00")) == "a b?[2J?"
    assert len(one_line(ValueError("x" * 10_000))) == 300
