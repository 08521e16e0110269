"""Text is UTF-8 in whatever locale: every call that reads or writes some says so, and commands go through in others."""

import ast
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.cli.environment import REPOSITORY, envpred
from tests.remedies import refusal
from tests.store.stores import write_store

TEXT = ("read_text", "write_text", "open", "NamedTemporaryFile", "TextIOWrapper", "fdopen")
NO_TEXT = ("os.open", "Image.open", "PIL.Image.open", "archive.open")
MODES = 1  # the place of the mode among the arguments of the function `open`; of the method it is one before


def calls_in_the_locales_encoding(file: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.Call):
            continue
        method = isinstance(node.func, ast.Attribute)
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        given = {keyword.arg: keyword.value for keyword in node.keywords}
        if name not in TEXT or "encoding" in given or ast.unparse(node.func) in NO_TEXT:
            continue
        if len(node.args) > {"read_text": 0, "write_text": 1}.get(name, len(node.args)):
            continue  # by its place
        place = MODES - method
        mode = given.get("mode", node.args[place] if len(node.args) > place else None)
        if isinstance(mode, ast.Constant) and "b" in str(mode.value):
            continue
        yield f"{file.relative_to(REPOSITORY)}:{node.lineno}: {ast.unparse(node)}"


def test_no_text_depends_on_the_locale() -> None:
    files = [file for room in ("envpred", "sweeps", "examples") for file in (REPOSITORY / room).rglob("*.py")]
    assert [call for file in files for call in calls_in_the_locales_encoding(file)] == []


def locale(kind: str, folder: Path) -> dict[str, Any]:
    """Variables that set a locale of another encoding, whatever the machine has installed."""
    if kind == "ASCII":
        return {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    name = "de_DE.ISO-8859-1"
    if shutil.which("localedef") is None:
        pytest.skip("no program makes locales here")
    subprocess.run(
        ["localedef", "-c", "-i", "POSIX", "-f", "ISO-8859-1", folder / name], capture_output=True, check=False
    )
    variables: dict[str, Any] = {"LC_ALL": name, "LOCPATH": str(folder), "PYTHONUTF8": "0"}
    asked = [sys.executable, "-c", "import sys; print(sys.getfilesystemencoding())"]
    if subprocess.run(asked, env=os.environ | variables, capture_output=True, check=False).stdout != b"iso8859-1\n":
        pytest.skip("the locale cannot be made here")
    return variables


@pytest.mark.parametrize("kind", ["ASCII", "ISO-8859-1"])
def test_names_that_the_locale_does_not_spell(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    variables = locale(kind, tmp_path)
    (tmp_path / "straße").mkdir()
    monkeypatch.chdir(tmp_path / "straße")
    write_store(Path("gräben"), {"gasse_ß": [0, 1, 2]}, cells=8)
    drawn = envpred("show", "--store=gräben", "--drive=gasse_ß", "--out=bild_ä.png", **variables)
    assert (drawn.returncode, drawn.stdout, drawn.stderr) == (0, "bild_ä.png\n", "")
    assert Path("bild_ä.png").is_file()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ASCII", "ISO-8859-1"])
def test_from_a_store_to_a_report_in_another_locale(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    variables = locale(kind, tmp_path)
    monkeypatch.chdir(tmp_path)
    write_store(Path("gräben"), {name: list(range(40)) for name in ("ä", "ö", "ü")})
    data = ["--data.store=gräben", "--out=läufe", "--trainer.accelerator=cpu", "--data.samples=2", "--data.crop=null"]
    fit = ["--config=prednet_small", "--model.channels=[4]", "--model.t1_epochs=1", "--model.t5_epochs=1"]
    for args in (["fit", *fit], ["test", *fit, "--ckpt_path=best"], ["test", "--model=LastFrame"]):
        done = envpred(*args, *data, **variables)
        assert done.returncode == 0, done.stderr
    done = envpred("report", "läufe/test", "--out=bericht_ö", **variables)
    assert (done.returncode, done.stdout) == (0, "bericht_ö/report.html\n")
    text = Path("bericht_ö/report.html").read_text(encoding="utf-8")
    assert "ü, frame" in text or "ö, frame" in text or "ä, frame" in text


def test_a_name_that_is_no_utf_8() -> None:
    assert refusal(["verify", "--store=gr\udce4ben"]) == "--store=gr\ufffdben: no name in UTF-8; rename it"
