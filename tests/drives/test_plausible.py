"""Recordings that cannot be right, as they come: each is one line with file and value, or a warning that is kept."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from envpred.build import jobs
from envpred.build.glances import Glances
from envpred.build.grids import build, map_drive, mapped, mapper_of
from envpred.cli.commands import verify
from envpred.datamodules import GridDataModule
from envpred.drives import one_drive
from envpred.drives.plausible import oddities
from envpred.errors import UserError
from envpred.mapping.mapper import MappingParameters
from envpred.store import Store
from tests.drives.synthetic import write_drive, write_sequence

FRAMES, SPEED = 12, 5.0
LATITUDE, LONGITUDE, YAW, NORTH, EAST = 0, 1, 5, 6, 7  # fields of a packet


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive with nothing odd about it, whose packets state its speed."""
    folder = write_drive(tmp_path_factory.mktemp("sound"), frames=FRAMES, speed=SPEED, heading=0.0)
    for file in (folder / "oxts" / "data").iterdir():
        change_fields(file, {EAST: SPEED})
    return folder


@pytest.fixture
def folder(sound: Path, tmp_path: Path) -> Path:
    shutil.copytree(sound.parents[1], tmp_path / "drives")
    return tmp_path / "drives" / sound.parent.name / sound.name


def change_fields(file: Path, values: dict[int, float]) -> None:
    fields = file.read_text(encoding="utf-8").split()
    for field, value in values.items():
        fields[field] = repr(value)
    file.write_text(" ".join(fields) + "\n", encoding="utf-8")


def packets(values: dict[int, float], frames: slice = slice(None)) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        for file in sorted((folder / "oxts" / "data").iterdir())[frames]:
            change_fields(file, values)

    return change


def scans(made: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        for file in (folder / "velodyne_points" / "data").iterdir():
            points = np.fromfile(file, np.float32).reshape(-1, 4)
            made(points[: len(points) // 4 * 4]).tofile(file)  # whole scans of any kind of number

    return change


def calibration(rotation: str, translation: str = "-0.81 0.32 -0.8") -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        file = folder.parent / "calib_imu_to_velo.txt"
        file.write_text(f"R: {rotation}\nT: {translation}\n")

    return change


def stamps(order: Callable[[list[str]], list[str]], part: str = "velodyne_points") -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        file = folder / part / "timestamps.txt"
        file.write_text("\n".join(order(file.read_text().splitlines())) + "\n")

    return change


def every(seconds: float) -> Callable[[list[str]], list[str]]:
    """Stamps so many seconds apart."""
    return lambda lines: [
        f"2011-09-26 13:{int(k * seconds) // 60:02d}:{k * seconds % 60:09.6f}000" for k in range(len(lines))
    ]


MILLIMETRES = np.array([1000, 1000, 1000, 1], np.float32)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (packets({LATITUDE: 95.0}, slice(3, 4)), r"0000000003\.txt: a latitude of 95 is beyond 85 degrees"),
        (packets({LONGITUDE: -200.0}), r"0000000000\.txt: a longitude of -200 is beyond 180"),
        (packets({YAW: 90.0}), r"a yaw of 90 is beyond 6\.283 radians"),
        (packets({LATITUDE: 0.0, LONGITUDE: 0.0}), r"0000000000\.txt: latitude 0 and longitude 0 are no position"),
        (packets({LATITUDE: 49.1}, slice(5, 6)), r"_0001_sync: frame 5 lies .* m from frame 4, 0\.1 s before it"),
        (scans(lambda p: p[:, :3].copy()), r"\.bin: a reflectance of -\d.*cannot be negative; write scans with four"),
        (scans(lambda p: p.astype(np.float64)), r"\.bin: (a coordinate of|holds coordinates that are not)"),
        (scans(lambda p: p.byteswap()), r"\.bin: (a coordinate of|holds coordinates that are not)"),
        (scans(lambda p: p * MILLIMETRES), r"\.bin: a coordinate of \d\S* m, where none is beyond 1000 m"),
        (calibration("1 0 0 0 -1 0 0 0 1"), r"calib_imu_to_velo\.txt: its matrix mirrors \(determinant -1,"),
        (calibration("1 0 0 0 1 0 0 0 1", "-810 320 -800"), r"the sensor 118\d m away from the body; give metres"),
        (stamps(lambda lines: lines[::-1]), r"timestamps\.txt: frame 1 has no later time than frame 0"),
        (stamps(lambda lines: lines[:1] * len(lines)), r"timestamps\.txt: frame 1 has no later time than frame 0"),
        (stamps(every(1.0)), r"timestamps\.txt: stamps and positions make 0\.5 m/s, and the packets say 5; .* 1 scans"),
        (stamps(every(0.05)), r"timestamps\.txt: stamps and positions make 10 m/s, and the packets say 5; .* 20 scans"),
        (stamps(every(5.0)), r"timestamps\.txt: frames 5 s apart"),
    ],
)
def test_what_cannot_be_is_refused_by_file_and_value(
    folder: Path, tmp_path: Path, change: Callable[[Path], None], message: str
) -> None:
    change(folder)
    Store(tmp_path / "grids").claim("mapping", MappingParameters().as_dict())
    with pytest.raises(UserError, match=message) as failure:
        map_drive(one_drive(folder), tmp_path / "grids", MappingParameters(), {"mapping": "k"})
    assert "\n" not in str(failure.value)
    assert not Store(tmp_path / "grids").drives


def test_a_sound_drive_has_nothing_odd(folder: Path) -> None:
    drive = one_drive(folder)
    assert oddities(drive, drive.sensor_to_body()) == []


def test_a_mirrored_calibration_of_a_sequence_is_refused(tmp_path: Path) -> None:
    folder = write_sequence(tmp_path, frames=2)
    lines = (folder / "calib.txt").read_text().splitlines()
    numbers = np.array(lines[-1].split()[1:], np.float64).reshape(3, 4) * [[-1], [1], [1]]
    (folder / "calib.txt").write_text("\n".join([*lines[:-1], "Tr: " + " ".join(map(str, numbers.ravel()))]))
    with pytest.raises(UserError, match=r"calib\.txt: its matrix mirrors"):
        one_drive(folder).frames  # noqa: B018


def test_a_mirrored_pose_is_refused(tmp_path: Path) -> None:
    folder = write_sequence(tmp_path, frames=3)
    poses = np.loadtxt(tmp_path / "poses" / "00.txt").reshape(-1, 3, 4)
    poses[1, :, 0] *= -1
    np.savetxt(tmp_path / "poses" / "00.txt", poses.reshape(-1, 12))
    drive = one_drive(folder)
    with pytest.raises(UserError, match="sequence_00: pose of frame 1: its matrix mirrors"):
        oddities(drive, drive.sensor_to_body())


def test_what_is_odd_is_kept_and_repeated(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The ground is too low and the stamps are too slow by 15 %; the grids are made, and everybody says so."""
    scans(lambda p: (p - np.array([0, 0, 1.2, 0], np.float32)).clip(min=[-99, -99, -99, 0]).astype(np.float32))(folder)
    stamps(every(0.115))(folder)
    monkeypatch.setattr(
        jobs, "in_processes", lambda job, drives, _: ((len(d.frames), job(d, lambda: None)) for d in drives)
    )
    store = tmp_path / "grids"
    build(folder, store, workers=1)
    built = capsys.readouterr().err
    slow, low = Store(store).drives[folder.name].warnings
    assert "stamps and positions make 4.35 m/s, and the packets say 5" in slow
    assert "the ground lies 2.93 m below the sensor, which is said to be 1.73 m above it" in low
    assert f"warning: {slow}" in built
    verify(store)
    assert f"warning: {low}" in capsys.readouterr().out
    module = GridDataModule(store, length=3, given=1)
    module.setup("test")
    assert module.describe("test")["warnings"] == {folder.name: [slow, low]}


def test_a_drive_that_sees_nothing_is_odd(folder: Path) -> None:
    """Something is stuck to the sensor's housing all around."""
    turn = np.linspace(0, 2 * np.pi, 720)
    ring = np.stack([4 * np.cos(turn), 4 * np.sin(turn), 0.5 * (turn < 9), 0 * turn], axis=1).astype(np.float32)
    scans(lambda _: ring)(folder)
    drive, glances = one_drive(folder), Glances(FRAMES, 1.73)
    for _ in mapped(drive, mapper_of(drive, MappingParameters()), glances.look):
        pass
    unknown, ground = glances.oddities(drive.name)
    assert "of the cells are unknown on average" in unknown
    assert "no ground within 10 m in 100% of the scans" in ground
