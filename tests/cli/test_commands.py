"""What envpred's own commands refuse."""

from pathlib import Path

import pytest

from tests.drives.synthetic import write_drive
from tests.remedies import refusal
from tests.store.stores import write_store

DRIVE = "2011_09_26_drive_0001_sync"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("commands")
    write_drive(root / "drives", frames=3)
    write_store(root / "grids", {"a": [0, 1, 2]}, cells=8)
    return root


@pytest.mark.parametrize(
    ("args", "line"),
    [
        (["ground", "--source=drives", "--frame=7"], f"{DRIVE} has no frame 7; it has 0 to 2"),
        (["show", "--store=grids", "--drive=b"], "grids: holds no drive b; it has a"),
        (["show", "--store=grids", "--frame=3"], "--frame 3: a has 3 frames, counted from 0"),
    ],
)
def test_what_is_not_there(folder: Path, monkeypatch: pytest.MonkeyPatch, args: list[str], line: str) -> None:
    monkeypatch.chdir(folder)
    assert refusal([*args, "--out=picture.png"]) == line
    assert not Path("picture.png").exists()
