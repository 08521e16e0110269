"""KITTI raw: pairing by name, gaps, poses, and every kind of damage refused by name."""

import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pykitti.utils
import pytest

from envpred.drives import Drive, find_drives
from envpred.errors import UserError
from envpred.mapping.geometry import PAPER_SENSOR_OFFSET
from tests.drives.synthetic import HOME, motion, write_calibration, write_drive

BINARY = "\x81\xff\x00\xfe" * 80  # no text in UTF-8


def only(root: Path) -> Drive:
    """The one drive under `root`."""
    [drive] = find_drives(root)
    return drive


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive without gaps; not to be changed."""
    return write_drive(tmp_path_factory.mktemp("kitti"), frames=12, heading=0.4, weave=0.2, images=True)


def test_a_drive_is_found_at_its_folder_its_day_and_their_root(whole: Path) -> None:
    for root in (whole, whole.parent, whole.parent.parent):
        drive = only(root)
        assert drive.name == "2011_09_26_drive_0001_sync"
        assert drive.frames == list(range(12))
        assert drive.stretches() == [(0, 12)]


@pytest.mark.parametrize("beside", ["link", "drive"])
def test_a_drive_may_be_a_link_to_another_disk(tmp_path: Path, beside: str) -> None:
    """The day's calibration then lies beside the link, or beside what it leads to."""
    folder = write_drive(tmp_path / "disk", frames=3)
    link = tmp_path / "source" / folder.parent.name / folder.name
    link.parent.mkdir(parents=True)
    link.symlink_to(folder.rename(folder.parent / "elsewhere"))
    if beside == "link":
        (folder.parent / "calib_imu_to_velo.txt").rename(link.parent / "calib_imu_to_velo.txt")
    drive = only(tmp_path / "source")
    assert (drive.name, drive.frames) == (link.name, [0, 1, 2])
    assert drive.sensor_to_body() == pytest.approx(PAPER_SENSOR_OFFSET)


def test_a_drive_is_named_by_its_folder_however_that_is_given(whole: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(whole / "oxts")
    assert only(Path("..")).name == whole.name
    monkeypatch.chdir(whole)
    assert only(Path()).name == whole.name


def test_drives_of_several_days_come_sorted_by_name(tmp_path: Path) -> None:
    for number in ("0013", "0002", "0005"):
        write_drive(tmp_path, number, frames=1)
    assert [drive.name[-9:-5] for drive in find_drives(tmp_path)] == ["0002", "0005", "0013"]


def test_scans_come_as_they_were_written(whole: Path) -> None:
    points = only(whole).scan(3)
    raw = np.fromfile(whole / "velodyne_points" / "data" / "0000000003.bin", np.float32)
    assert points.dtype == np.float32
    assert (points == raw.reshape(-1, 4)).all()


def test_poses_are_pykitti_s_and_those_of_the_motion(whole: Path) -> None:
    drive = only(whole)
    packets = pykitti.utils.load_oxts_packets_and_poses(sorted((whole / "oxts" / "data").iterdir()))
    assert (drive.poses == np.stack([packet.T_w_imu for packet in packets])).all()
    assert np.abs(drive.poses - motion(12, 5.0, 0.4, 0.2)).max() < 1e-6
    assert packets[0].packet.lat == HOME[0]


def test_calibration_is_inverted(whole: Path) -> None:
    assert only(whole).sensor_to_body() == pytest.approx(PAPER_SENSOR_OFFSET)


def test_a_turned_calibration_takes_the_sensor_to_the_body(tmp_path: Path) -> None:
    drive = only(write_drive(tmp_path, frames=1))
    (tmp_path / "2011_09_26" / "calib_imu_to_velo.txt").write_text("R: 0 -1 0 1 0 0 0 0 1\nT: 1 2 3\n")
    # IMU (1, 0, 0) lies at R (1, 0, 0) + T = (1, 3, 3) in the sensor frame, and back.
    assert drive.sensor_to_body() @ [1, 3, 3, 1] == pytest.approx([1, 0, 0, 1])


def test_times_and_pictures(whole: Path) -> None:
    drive = only(whole)
    assert [drive.time(k) for k in drive.frames] == pytest.approx(0.1 * np.arange(12), abs=2e-6)
    assert drive.image(7) == whole / "image_02" / "data" / "0000000007.png"
    assert drive.image(99) is None


def test_scans_and_packets_are_paired_by_name(tmp_path: Path) -> None:
    folder = write_drive(tmp_path, frames=12, missing_scans={3, 4}, missing_packets={8})
    drive = only(folder)
    assert drive.frames == [0, 1, 2, 5, 6, 7, 9, 10, 11]
    assert drive.stretches() == [(0, 3), (3, 3), (6, 3)]
    expected = motion(12)
    for k in drive.frames:
        assert drive.pose(k) == pytest.approx(expected[k], abs=1e-6)
    assert (
        drive.scan(5) == np.fromfile(folder / "velodyne_points/data/0000000005.bin", np.float32).reshape(-1, 4)
    ).all()
    # The time stamps of frames that are not there are blank lines.
    assert [drive.time(k) for k in drive.frames] == pytest.approx(0.1 * np.array(drive.frames), abs=2e-6)


def test_the_world_starts_at_the_first_packet_even_without_a_scan(tmp_path: Path) -> None:
    drive = only(write_drive(tmp_path, frames=5, missing_scans={0, 1}))
    assert drive.frames == [2, 3, 4]
    assert drive.pose(2)[:2, 3] == pytest.approx([1.0, 0.0], abs=1e-6)  # 5 m/s for 0.2 s
    assert [drive.time(k) for k in drive.frames] == pytest.approx([0, 0.1, 0.2], abs=2e-6)


@pytest.mark.parametrize("part", ["velodyne_points", "oxts", "both"])
def test_time_stamps_that_are_not_there_are_replaced(tmp_path: Path, part: str) -> None:
    folder = write_drive(tmp_path, frames=4)
    for name in ("velodyne_points", "oxts") if part == "both" else (part,):
        (folder / name / "timestamps.txt").unlink()
    assert [only(folder).time(k) for k in range(4)] == pytest.approx([0, 0.1, 0.2, 0.3], abs=2e-6)


def test_blank_lines_among_time_stamps_keep_the_others_in_their_place(tmp_path: Path) -> None:
    folder = write_drive(tmp_path, frames=5)
    (folder / "oxts" / "timestamps.txt").unlink()
    stamps = ["2011-09-26 13:02:25.000000445", "", "2011-09-26 13:02:25.240000445", "2011-09-26 13:02:25.360000445"]
    (folder / "velodyne_points" / "timestamps.txt").write_text("\n".join(stamps))
    # Frame 1 has a blank line and frame 4 none: both are taken to be at 10 Hz from the first.
    assert [only(folder).time(k) for k in range(5)] == pytest.approx([0, 0.1, 0.24, 0.36, 0.4], abs=2e-6)


def test_a_drive_travels_to_another_process(whole: Path) -> None:
    drive = only(whole)
    drive.frames  # noqa: B018  what is cached must travel too
    other = pickle.loads(pickle.dumps(drive))
    assert other.frames == drive.frames
    assert (other.scan(2) == drive.scan(2)).all()


def test_a_drive_without_scans_has_no_frames(tmp_path: Path) -> None:
    assert only(write_drive(tmp_path, frames=2, missing_scans={0, 1})).frames == []


SCAN, PACKET = "velodyne_points/data/0000000001.bin", "oxts/data/0000000001.txt"


def cut_within_a_number(file: Path) -> None:
    file.write_bytes(file.read_bytes()[:-5])


def cut_within_a_point(file: Path) -> None:
    file.write_bytes(file.read_bytes()[:-8])


def empty(file: Path) -> None:
    file.write_bytes(b"")


def spoil(column: int, value: float) -> Callable[[Path], None]:
    """Put a number that is none into the middle of a scan."""

    def change(file: Path) -> None:
        points = np.fromfile(file, np.float32).reshape(-1, 4)
        points[len(points) // 2, column] = value
        points.tofile(file)

    return change


def both_infinite(file: Path) -> None:
    spoil(0, np.inf)(file)
    spoil(1, -np.inf)(file)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (cut_within_a_number, "cut short"),
        (cut_within_a_point, "cut short"),
        (empty, "empty scan"),
        (spoil(0, np.nan), "not finite"),
        (spoil(2, np.inf), "not finite"),
        (both_infinite, "not finite"),
        (Path.unlink, "cannot be read"),
    ],
)
def test_a_damaged_scan_is_refused_by_name(tmp_path: Path, damage: Callable[[Path], None], message: str) -> None:
    folder = write_drive(tmp_path, frames=3)
    drive = only(folder)
    assert drive.frames == [0, 1, 2]
    damage(folder / SCAN)
    with pytest.raises(UserError, match=message) as caught:
        drive.scan(1)
    assert str(folder / SCAN) in str(caught.value)
    assert "copy it again" in str(caught.value)
    assert len(drive.scan(2)), "the others can still be read"


@pytest.mark.parametrize(
    "text", ["", "49.0 8.4 112.8", "0 " * 29, "0 " * 31, "0 " * 12 + "abc " + "0 " * 17, "nan " + "0 " * 29, BINARY]
)
def test_a_damaged_packet_is_refused_by_name(tmp_path: Path, text: str) -> None:
    folder = write_drive(tmp_path, frames=3)
    (folder / PACKET).write_text(text, "latin-1")
    with pytest.raises(UserError, match=r"30 numbers|is no text") as caught:
        only(folder).frames  # noqa: B018
    assert str(folder / PACKET) in str(caught.value)
    assert "copy it again" in str(caught.value)


def test_a_drive_without_packets_is_refused_by_name(tmp_path: Path) -> None:
    folder = write_drive(tmp_path, frames=2, missing_packets={0, 1})
    with pytest.raises(UserError, match="no OXTS packets") as caught:
        only(folder).frames  # noqa: B018
    assert str(folder / "oxts" / "data") in str(caught.value)


def test_a_missing_calibration_is_refused_with_both_remedies(tmp_path: Path) -> None:
    drive = only(write_drive(tmp_path, frames=1, calibration=False))
    with pytest.raises(UserError, match="calibration is missing") as caught:
        drive.sensor_to_body()
    for part in ("calib_imu_to_velo.txt", "2011_09_26_calib.zip", "--sensor paper"):
        assert part in str(caught.value)
    write_calibration(tmp_path / "2011_09_26")
    assert drive.sensor_to_body().shape == (4, 4)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "no colon",
        "R: 1 0 0\nT: 0 0 0",
        "R: 1 0 0 0 1 0 0 0 1",
        "R: a b c\nT: 0 0 0",
        "R: 2 0 0 0 1 0 0 0 1\nT: 0 0 0",
        "R: 1 0 0 0 1 0 0 0 nan\nT: 0 0 0",
        "R: 1 0 0 0 1 0 0 0 1\nT: 0 0 inf",
        BINARY,
    ],
)
def test_a_damaged_calibration_is_refused_by_name(tmp_path: Path, text: str) -> None:
    folder = write_drive(tmp_path, frames=1)
    (folder.parent / "calib_imu_to_velo.txt").write_text(text, "latin-1")
    with pytest.raises(UserError, match=r"calib_imu_to_velo.txt: .*copy it again"):
        only(folder).sensor_to_body()


@pytest.mark.parametrize("stamp", ["noon", BINARY])
def test_a_damaged_time_stamp_is_refused_by_line(tmp_path: Path, stamp: str) -> None:
    folder = write_drive(tmp_path, frames=3)
    file = folder / "velodyne_points" / "timestamps.txt"
    file.write_text("\n".join(["2011-09-26 13:02:25.964389445", stamp, ""]), "latin-1")
    with pytest.raises(UserError, match=r"line 2|is no text") as caught:
        only(folder).time(0)
    assert str(file) in str(caught.value)


def test_a_root_without_drives_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no drive found"):
        find_drives(tmp_path)
    with pytest.raises(UserError, match="no such folder"):
        find_drives(tmp_path / "nowhere")


def test_two_drives_of_one_name_are_refused(tmp_path: Path) -> None:
    write_drive(tmp_path, frames=1)
    write_drive(tmp_path / "2011_09_26", frames=1).parent.rename(tmp_path / "copy")
    with pytest.raises(UserError, match="two drives are named"):
        find_drives(tmp_path)
