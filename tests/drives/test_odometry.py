"""KITTI odometry sequences: another layout of the same drive gives the same grids."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from envpred.build.grids import mapped, mapper_of
from envpred.drives import Drive, find_drives
from envpred.errors import UserError
from envpred.mapping.mapper import MappingParameters
from tests.drives.synthetic import motion, write_drive, write_sequence


def grids(drive: Drive) -> tuple[NDArray[np.uint8], NDArray[np.int32]]:
    """Label grids (T, H, W) and centre cells (T, 2) of a drive."""
    frames = list(mapped(drive, mapper_of(drive, MappingParameters())))
    return np.stack([frame.label for frame in frames]), np.stack([frame.centre_cell for frame in frames])


@pytest.fixture
def sequence(tmp_path: Path) -> Path:
    """The folder of a small sequence."""
    return write_sequence(tmp_path, "07", frames=4)


def test_the_same_motion_gives_the_same_grids_as_kitti_raw(tmp_path: Path) -> None:
    options = {"frames": 25, "speed": 6.3, "weave": 0.15}
    [raw] = find_drives(write_drive(tmp_path / "raw", **options))  # type: ignore[arg-type]
    [odometry] = find_drives(write_sequence(tmp_path / "odometry", **options))  # type: ignore[arg-type]
    labels, cells = grids(raw)
    other, other_cells = grids(odometry)
    assert (cells == other_cells).all()
    assert np.ptp(cells[:, 0]) > 40, "the grid moves"
    assert (labels == other).mean() > 0.9999
    assert len(np.unique(labels)) == 4


@pytest.mark.parametrize("above", ["", "sequences", "sequences/07"])
def test_a_sequence_is_found_wherever_its_root_is_given(sequence: Path, above: str) -> None:
    [drive] = find_drives(sequence.parents[1] / above)
    assert drive.name == "sequence_07"
    assert drive.frames == [0, 1, 2, 3]


def test_a_sequence_is_found_in_the_archive_s_folder_dataset(tmp_path: Path) -> None:
    write_sequence(tmp_path / "dataset", frames=2)
    assert [drive.name for drive in find_drives(tmp_path)] == ["sequence_00"]


def test_poses_are_the_body_s_in_the_first_scan_s_frame(sequence: Path) -> None:
    [drive] = find_drives(sequence)
    assert np.abs(drive.poses - motion(4)).max() < 1e-9
    assert [drive.time(k) for k in drive.frames] == pytest.approx([0, 0.1, 0.2, 0.3])
    assert drive.image(0) is None


def test_semantic_kitti_s_poses_in_the_sequence_come_first(sequence: Path) -> None:
    poses = sequence.parents[1] / "poses" / "07.txt"
    (sequence / "poses.txt").write_text("\n".join(poses.read_text().splitlines()[:2]))
    [drive] = find_drives(sequence)
    assert drive.frames == [0, 1], "frames without a pose are left out"


def test_a_sequence_may_be_a_link_to_another_disk(sequence: Path, tmp_path: Path) -> None:
    poses = find_drives(sequence)[0].poses
    link = tmp_path / "linked" / "sequences" / sequence.name
    link.parent.mkdir(parents=True)
    link.symlink_to(sequence)
    for _ in range(2):
        [drive] = find_drives(tmp_path / "linked")
        assert (drive.poses == poses).all()
        folder = sequence.parents[1] / "poses"
        if folder.is_dir():  # once beside what the link leads to, once beside the link
            folder.rename(tmp_path / "linked" / "poses")


def test_a_missing_scan_leaves_a_gap(sequence: Path) -> None:
    (sequence / "velodyne" / "000001.bin").rename(sequence / "velodyne" / "²³.bin")  # digits, but no number
    (sequence / "times.txt").unlink()
    [drive] = find_drives(sequence)
    assert drive.frames == [0, 2, 3]
    assert drive.stretches() == [(0, 1), (1, 2)]
    assert [drive.time(k) for k in drive.frames] == pytest.approx([0, 0.2, 0.3])


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("calib.txt", "P0: 1 2 3\n", "12 numbers"),
        ("calib.txt", "Tr: 1 2 3\n", "12 numbers"),
        ("calib.txt", None, "missing"),
        ("../../poses/07.txt", "1 2 3\n", "12 numbers"),
        ("../../poses/07.txt", "nan " * 12, "12 numbers"),
        ("../../poses/07.txt", "east\n", "12 numbers"),
        ("../../poses/07.txt", None, "no poses"),
        ("times.txt", "0.0\n", "1 times for 4 poses"),
        ("times.txt", "noon\n", "no number of seconds"),
        ("calib.txt", "\x81\xff\x00", "12 numbers"),
        ("../../poses/07.txt", "\x81\xff\x00", "12 numbers"),
        ("times.txt", "\x81\xff\x00", "no number of seconds"),
    ],
)
def test_damage_is_refused_by_name(sequence: Path, name: str, text: str | None, message: str) -> None:
    file = (sequence / name).resolve()
    if text is None:
        file.unlink()
    else:
        file.write_text(text, "latin-1")
    [drive] = find_drives(sequence)
    ask: Callable[[], object] = lambda: drive.time(0) if name == "times.txt" else drive.frames  # noqa: E731
    with pytest.raises(UserError, match=message) as caught:
        ask()
    assert str(file) in str(caught.value)
