"""Which sweeps a command runs: those that came with envpred, whatever else is called so."""

import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from envpred.cli import sweeps
from envpred.errors import UserError

REPOSITORY = Path(__file__).resolve().parents[2]
ASK = "from envpred.cli.sweeps import module; found = module('runs.progress'); print(found.__name__, found.__file__)"


def write_package(folder: Path, says: str) -> Path:
    """A package `sweeps` with a module `tune`."""
    package = folder / "sweeps"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("")
    (package / "tune.py").write_text(f"SAYS = {says!r}")
    return package


def test_those_beside_the_package_are_taken_not_those_of_the_current_folder(tmp_path: Path) -> None:
    write_package(tmp_path, "theirs")
    done = subprocess.run([sys.executable, "-c", ASK], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["sweeps.runs.progress", str(REPOSITORY / "sweeps" / "runs" / "progress.py")]


def test_those_inside_the_package_come_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    installed = tmp_path / "site" / "installed_envpred"
    write_package(installed, "ours")
    (installed / "__init__.py").write_text("")
    write_package(tmp_path / "site", "beside")
    monkeypatch.syspath_prepend(tmp_path / "site")
    monkeypatch.setattr(sweeps, "PACKAGE", installed)
    found = sweeps.module("tune")
    assert (found.__name__, found.SAYS) == ("installed_envpred.sweeps.tune", "ours")


def test_none_and_hidden_ones_are_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sweeps, "PACKAGE", tmp_path / "nothing" / "envpred")
    with pytest.raises(UserError, match="came without its sweeps; install envpred again"):
        sweeps.module("tune")
    monkeypatch.undo()
    theirs = ModuleType("sweeps")
    theirs.__file__ = str(write_package(tmp_path, "theirs") / "__init__.py")
    monkeypatch.setitem(sys.modules, "sweeps", theirs)
    with pytest.raises(UserError, match=f"{theirs.__file__}: a package of the name sweeps hides that of envpred"):
        sweeps.module("tune")
