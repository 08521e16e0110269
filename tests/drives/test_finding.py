"""Finding drives by readers: in this package, from other packages, and those that cannot be used."""

import importlib
import sys
from collections.abc import Iterator
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path

import pytest

import envpred.drives
from envpred.drives import find_drives, finding
from envpred.errors import UserError
from tests.drives.synthetic import write_drive

READER = """
from envpred.drives.kitti import KittiDrive

class MyDrive(KittiDrive):
    pass

def {find}(root):
    drives = [MyDrive(place) for place in root.glob("*/*_mine") if place.is_dir()]
    return drives
"""


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """A folder with a drive that KITTI's readers know, and one under another name, which lies elsewhere."""
    write_drive(tmp_path / "drives", "0001", frames=3)
    return tmp_path / "drives"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder whose modules count as the package's own."""
    extra = tmp_path / "readers"
    extra.mkdir()
    monkeypatch.setattr(envpred.drives, "__path__", [*envpred.drives.__path__, str(extra)])
    importlib.invalidate_caches()
    yield extra
    sys.modules.pop("envpred.drives.mine", None)


def test_a_reader_is_one_file(source: Path, folder: Path) -> None:
    (folder / "mine.py").write_text(READER.format(find="find").replace("*_mine", "*_sync"))
    with pytest.raises(UserError, match="two drives are named"):
        find_drives(source)


def test_a_reader_whose_find_is_misspelt_is_named(source: Path, folder: Path) -> None:
    (folder / "mine.py").write_text(READER.format(find="fnid"))
    with pytest.raises(UserError, match=r"mine\.py: defines MyDrive but no function find\(root\)"):
        find_drives(source)


def test_a_module_without_drives_is_none_of_the_readers(source: Path, folder: Path) -> None:
    (folder / "mine.py").write_text("from envpred.drives.kitti import KittiDrive\n")
    assert len(find_drives(source)) == 1


def offer(monkeypatch: pytest.MonkeyPatch, value: str) -> None:
    entry = EntryPoint("mine", value, finding.GROUP)
    monkeypatch.setattr(finding, "entry_points", lambda group: EntryPoints([entry]).select(group=group))


def test_another_package_brings_a_reader(source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reader = READER.format(find="look").replace("*_mine", "*_sync").replace("    return drives\n", "")
    (tmp_path / "some_package.py").write_text(reader + "    drives[0].name = 'mine'\n    return drives\n")
    monkeypatch.syspath_prepend(tmp_path)
    offer(monkeypatch, "some_package:look")
    assert [drive.name for drive in find_drives(source)] == ["2011_09_26_drive_0001_sync", "mine"]


@pytest.mark.parametrize("value", ["no_such_package:find", "envpred.drives.kitti:fnid"])
def test_a_reader_of_another_package_that_cannot_be_loaded_is_named(
    source: Path, monkeypatch: pytest.MonkeyPatch, value: str
) -> None:
    offer(monkeypatch, value)
    with pytest.raises(UserError, match=f"{value}: the reader mine of an installed package cannot be loaded"):
        find_drives(source)
