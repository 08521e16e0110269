"""The command line where the machine is not as it should be: a result, or one line, never a traceback."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

import pytest

from envpred import caches
from envpred.cli import main
from tests.cli.environment import envpred, installed, read_only
from tests.remedies import refusal
from tests.store.stores import write_store

HOMELESS = {"HOME": "/dev/null", "XDG_CACHE_HOME": "", "XDG_CONFIG_HOME": "", "NUMBA_CACHE_DIR": "", "MPLCONFIGDIR": ""}


def test_an_installation_that_cannot_be_written_and_no_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Loops are compiled and pictures drawn all the same, and what is compiled is kept where only we can write."""
    monkeypatch.chdir(tmp_path)
    write_store(tmp_path / "grids", {"a": [0, 1, 2]}, cells=8)
    package, temporary = installed(tmp_path / "installed"), tmp_path / "temporary"
    temporary.mkdir()
    variables = {**HOMELESS, "TMPDIR": str(temporary)}
    args = ("show", "--store=grids", "--out=picture.png")
    drawn = envpred(*args, prepare=read_only(package), package=package, **variables)
    assert (drawn.returncode, drawn.stdout, drawn.stderr) == (0, "picture.png\n", "")
    (kept,) = temporary.iterdir()
    assert kept.stat().st_mode & 0o777 == 0o700
    assert {folder.name for folder in kept.iterdir()} >= {"numba_cache_dir", "mplconfigdir"}


@pytest.mark.slow
def test_nothing_at_all_can_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = installed(tmp_path / "installed")
    monkeypatch.chdir(package)
    write_store(package / "grids", {"a": [0, 1, 2]}, cells=8)
    nothing = read_only(Path("/tmp"), Path("/var/tmp"), package)
    for args in (["--help"], ["grids", "--help"], ["fit", "--model.help"], ["configs"], ["verify", "--store=grids"]):
        done = envpred(*args, prepare=nothing, package=package, **HOMELESS)
        assert (done.returncode, done.stderr) == (0, ""), args


def test_compiled_code_is_not_loaded_from_a_folder_of_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    (ours,) = {caches._own(), caches._own()}
    assert ours is not None
    ours.chmod(0o777)
    assert caches._own() not in (None, ours)
    ours.rmdir()
    ours.symlink_to(tmp_path / "elsewhere")
    (tmp_path / "elsewhere").mkdir(mode=0o700)
    assert caches._own() not in (None, ours)
    assert not any(os.scandir(tmp_path / "elsewhere"))


PRINTING = [
    ["--help"],
    ["--version"],
    ["grids", "--help"],
    ["fit", "--model.help"],
    ["configs"],
    ["completion", "bash"],
    ["verify", "--store=grids"],
    ["show", "--store=grids", "--out=picture.png"],
    ["fit", "--config=prednet_small", "--config=dst_static", "--data.store=grids", "--print_config"],
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a store."""
    root = tmp_path_factory.mktemp("environment")
    write_store(root / "grids", {"a": [0, 1, 2]}, cells=8)
    return root


@pytest.fixture
def unread() -> Iterator[TextIO]:
    """A pipe whose reader has gone."""
    reading, writing = os.pipe()
    os.close(reading)
    with open(writing, "w", encoding="utf-8") as output:
        yield output


@pytest.mark.parametrize("args", PRINTING, ids=" ".join)
def test_output_that_nobody_reads_ends_quietly(
    folder: Path, unread: TextIO, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], args: list[str]
) -> None:
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "stdout", unread)
    with pytest.raises(SystemExit) as stop:
        main(args)
    assert stop.value.code == 141  # as a shell says of whoever is ended by SIGPIPE
    assert capsys.readouterr().err == ""


def test_a_mistake_is_told_though_nobody_reads_the_output(unread: TextIO, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", unread)
    assert refusal(["verify", "--store=nowhere"]).startswith("nowhere: no store of grids")


@pytest.mark.parametrize("args", PRINTING, ids=" ".join)
def test_output_that_takes_no_more_is_one_line(folder: Path, monkeypatch: pytest.MonkeyPatch, args: list[str]) -> None:
    monkeypatch.chdir(folder)
    with open("/dev/full", "w", encoding="utf-8") as output:
        monkeypatch.setattr(sys, "stdout", output)
        said = refusal(args)
    assert said == "standard output: No space left on device; make room, then run the same command again"


def test_names_that_the_output_cannot_encode(tmp_path: Path, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    with open(tmp_path / "printed", "w", encoding="ascii") as output:
        monkeypatch.setattr(sys, "stdout", output)
        main(["show", "--store=grids", "--out=strasse_ß.png"])
    assert (folder / "strasse_ß.png").is_file()
    assert (tmp_path / "printed").read_text() == "strasse_\\xdf.png\n"


@pytest.mark.parametrize("args", [["--help"], ["verify", "--store=grids"]], ids=" ".join)
def test_a_current_folder_that_is_gone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, args: list[str]) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    line = "the current folder is gone (No such file or directory); change into another one"
    assert refusal(args) == line


def test_the_end_of_the_interpreter_says_nothing_more(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Python writes at its end what is left to be written, and tells a second time that it could not."""
    monkeypatch.chdir(folder)
    for output, lines in (("| true", 0), ("> /dev/full", 1)):
        ended = subprocess.run(
            ["sh", "-c", f'"{sys.executable}" -m envpred --help {output}'], capture_output=True, text=True, check=False
        )
        assert len(ended.stderr.splitlines()) == lines
