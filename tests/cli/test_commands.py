"""What envpred's own commands refuse."""

import os
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
        (["show", "--store=grids", "--frame=-1"], "--frame -1: a has 3 frames, counted from 0"),
    ],
)
def test_what_is_not_there(folder: Path, monkeypatch: pytest.MonkeyPatch, args: list[str], line: str) -> None:
    monkeypatch.chdir(folder)
    assert refusal([*args, "--out=picture.png"]) == line
    assert not Path("picture.png").exists()


DRAWING = [
    ["show", "--store=nowhere"],
    ["velocity", "--store=nowhere"],
    ["ground", "--source=nowhere"],
    ["scan", "--source=nowhere"],
    ["traffic", "--recording=nowhere"],
    ["draw", "nowhere"],
]


@pytest.mark.parametrize("args", DRAWING, ids=lambda args: args[0])
def test_pictures_that_cannot_be_written_are_refused_before_anything_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, args: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("file").touch()
    Path("locked").mkdir()
    plays = args[0] in ("show", "velocity", "draw")
    endings = ".png, .pdf, .svg or .gif" if plays else ".png, .pdf or .svg"
    assert refusal([*args, "--out=x.xyz"]) == f"x.xyz: no picture that can be written; end its name on {endings}"
    if not plays:
        assert "x.gif: no picture that can be written" in refusal([*args, "--out=x.gif"])
    (Path("x.png")).mkdir()
    assert refusal([*args, "--out=x.png"]) == "x.png: is a folder; name a file in it"
    place = tmp_path / "file"
    said = f"file/new/x.pdf: cannot be written, as {place} is no folder; name another place"
    assert refusal([*args, "--out=file/new/x.pdf"]) == said
    monkeypatch.setattr(os, "access", lambda folder, _: folder != tmp_path / "locked")  # root may write everywhere
    place = tmp_path / "locked"
    said = f"locked/new/x.pdf: cannot be written, as {place} is a folder that cannot be written; name another place"
    assert refusal([*args, "--out=locked/new/x.pdf"]) == said
    assert sorted(os.listdir()) == ["file", "locked", "x.png"]
    assert "nowhere" in refusal([*args, "--out=new/x.pdf"])  # which is read now
