"""A bit that flips on the disk is found before anything is trained or judged on it; what was read once is believed."""

import json
import os
from pathlib import Path

import pytest

from envpred.datamodules import GridDataModule
from envpred.errors import UserError
from envpred.store import MANIFEST, StoredDrive, check_content
from tests.store.stores import write_store


@pytest.fixture
def store(tmp_path: Path) -> Path:
    return write_store(tmp_path / "grids", {name: list(range(24)) for name in "abc"})


def flip(file: Path) -> None:
    data = bytearray(file.read_bytes())
    data[-5] ^= 1
    file.write_bytes(data)


def set_up(store: Path, stage: str) -> None:
    GridDataModule(store, length=8, given=3).setup(stage)


@pytest.mark.parametrize("array", ["evidence", "centre_cell"])
def test_a_flipped_bit_is_found(store: Path, array: str) -> None:
    set_up(store, "test")
    flip(store / "c" / f"{array}.npy")
    set_up(store, "fit")  # drives that are not read are not looked at
    with pytest.raises(UserError, match=f"c/{array}.npy: its content has changed since it was built; delete"):
        set_up(store, "test")
    with pytest.raises(UserError, match="its content has changed"):  # again
        set_up(store, "test")


def test_files_are_read_once(store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[str] = []
    original = StoredDrive.verify_array

    def verify(drive: StoredDrive, name: str) -> None:
        read.append(f"{drive.name}/{name}")
        original(drive, name)

    monkeypatch.setattr(StoredDrive, "verify_array", verify)
    set_up(store, "fit")
    assert sorted(set(read)) == sorted(read)
    assert {place.split("/")[0] for place in read} == {"a", "b"}
    read.clear()
    set_up(store, "fit")
    assert read == []
    os.utime(store / "a" / "label.npy")
    set_up(store, "fit")
    assert read == ["a/label"]


def test_a_store_that_cannot_be_written_is_compared_each_time(store: Path) -> None:
    (store / ".checked.json").mkdir()  # no file can take its place
    set_up(store, "test")
    flip(store / "c" / "evidence.npy")
    with pytest.raises(UserError, match="its content has changed"):
        set_up(store, "test")


def test_an_array_that_is_not_there_names_the_command(tmp_path: Path) -> None:
    store = write_store(tmp_path / "grids", {"a": list(range(8))}, cells=8)
    manifest = json.loads((store / "a" / MANIFEST).read_text())
    del manifest["arrays"]["pose"]
    (store / "a" / MANIFEST).write_text(json.dumps(manifest))
    with pytest.raises(UserError, match=r"a: holds no array 'pose'; build it with `envpred grids"):
        check_content(store, [StoredDrive(store / "a")], ["label", "pose"])
