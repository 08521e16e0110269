from pathlib import Path

import pytest

from envpred.datamodules.selection import REFERENCE_TEST, REFERENCE_VALIDATION, preset, select
from envpred.errors import UserError
from envpred.store import Store
from tests.store.stores import write_store


def names(stretches: list) -> list[str]:  # type: ignore[type-arg]
    return [str(stretch) for stretch in stretches]


def store(tmp_path: Path, drives: list[str], frames: int = 10) -> Store:
    return Store(write_store(tmp_path / "grids", {name: list(range(frames)) for name in drives}, cells=8))


def test_paper_split_names_its_drives(tmp_path: Path) -> None:
    others = ["2011_09_26_drive_0001_sync", "2011_09_28_drive_0002_sync"]
    drives = store(tmp_path, [*REFERENCE_VALIDATION, *REFERENCE_TEST, *others]).drives
    for name in ("reference", "auto"):
        split = preset(name, drives)
        assert names(split.train) == others
        assert set(names(split.val)) == {"2011_09_26_drive_0005_sync", "2011_09_26_drive_0014_sync"}
        assert set(names(split.test)) == {"2011_09_26_drive_0091_sync", "2011_09_26_drive_0015_sync"}


def test_paper_split_without_its_drives_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="2011_09_26_drive_0005_sync"):
        preset("reference", store(tmp_path, ["a"]).drives)


@pytest.mark.parametrize(
    ("drives", "expected"),
    [
        (["a"], (["a@0-6"], ["a@6-8"], ["a@8-10"])),
        (["a", "b"], (["a@0-7"], ["a@7-10"], ["b"])),
        (["a", "b", "c"], (["a"], ["b"], ["c"])),
        (list("abcdefghij"), (list("abcdefg"), ["h"], ["i", "j"])),
    ],
)
def test_auto_split(tmp_path: Path, drives: list[str], expected: tuple[list[str], ...]) -> None:
    split = preset("auto", store(tmp_path, drives).drives)
    assert (names(split.train), names(split.val), names(split.test)) == expected


def test_ranges(tmp_path: Path) -> None:
    drives = store(tmp_path, ["a"]).drives
    assert names(select(["a@2-5", "a@-4", "a@7-", "a"], drives)) == ["a@2-5", "a@0-4", "a@7-10", "a"]
    for wrong in ("a@5-2", "a@0-11", "a@x-3", "a@3-3"):
        with pytest.raises(UserError, match="start-stop"):
            select([wrong], drives)
    with pytest.raises(UserError, match="drive b"):
        select(["b"], drives)


def test_runs_are_cut_to_the_range(tmp_path: Path) -> None:
    folder = write_store(tmp_path / "grids", {"a": [0, 1, 2, 3, 10, 11, 12]}, cells=8)
    (stretch,) = select(["a@2-6"], Store(folder).drives)
    assert stretch.stretches() == [(2, 2), (4, 2)]
