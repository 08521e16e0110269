"""Which scans a folder holds, in which order, and when their points were measured, worked out by hand."""

from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from envpred.drives.scan_folder import ScanFolder, Sweep
from envpred.gate.folders import Deskew, Scans


def scans(folder: Path, *names: str) -> ScanFolder:
    """Empty files of these names as the scans of a folder."""
    folder.mkdir()
    for name in names:
        (folder / f"{name}.bin").touch()
    return ScanFolder(folder, Scans(), np.eye(3), folder / "envpred.yaml")


@pytest.mark.parametrize(
    ("names", "numbers"),
    [
        (["8", "9", "10", "12"], [8, 9, 10, 12]),
        (["scan_9", "scan_10", "scan_100"], [0, 1, 2]),
        (["9.5", "10.25", "100.0"], [0, 1, 2]),  # times
        (["1700000000000000000", "1700000000100000000"], [0, 1]),  # times
        (["01", "1"], [0, 1]),  # one number twice
        (["a", "b"], [0, 1]),
    ],
)
def test_scans_follow_each_other_by_the_numbers_in_their_names(
    tmp_path: Path, names: list[str], numbers: list[int]
) -> None:
    found = scans(tmp_path / "scans", *names)
    assert [file.stem for file in found.files] == names
    assert found.numbers == numbers
    assert found.position == {k: n for n, k in enumerate(numbers)}


@pytest.mark.parametrize(
    ("turn", "start", "passed"),
    [
        ("clockwise", 180.0, [0.5, 0.25, 0.75]),  # from behind over the left
        ("counterclockwise", 180.0, [0.5, 0.75, 0.25]),
        ("counterclockwise", -45.0, [0.125, 0.375, 0.875]),
    ],
)
def test_points_are_timed_by_where_they_lie(
    tmp_path: Path, turn: Literal["clockwise", "counterclockwise"], start: float, passed: list[float]
) -> None:
    """Ahead, to the left, to the right: shares of a turn that has passed, of which half is before the stamp."""
    points = np.array([[5, 0, 0, 0], [0, 5, 0, 0], [0, -5, 0, 0]], np.float32)
    how = Deskew("azimuth", turn=turn, start=start, stamp="middle")
    since = scans(tmp_path / "scans").since_stamp(Sweep(points, {}, tmp_path), how, 0.1)
    np.testing.assert_allclose(since, 0.1 * np.array(passed) - 0.05, atol=1e-6)


def test_points_are_timed_by_a_column_in_its_unit(tmp_path: Path) -> None:
    """Whatever the clock of the column, the first of them was measured when the sweep began."""
    columns = {"t": np.array([1_000_040_000, 1_000_000_000, 1_000_080_000], np.uint32)}
    sweep = Sweep(np.zeros((3, 4), np.float32), columns, tmp_path)
    found = scans(tmp_path / "scans").since_stamp(sweep, Deskew("time", unit="us"), 0.1)
    np.testing.assert_allclose(found, [0.04, 0, 0.08])
