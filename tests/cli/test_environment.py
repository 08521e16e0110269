"""The command line where the machine is not as it should be: a result, or one line, never a traceback."""

import os
import tempfile
from pathlib import Path

import pytest

from envpred import caches
from tests.cli.environment import envpred, installed, read_only
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
