"""Faults injected into recordings that no threshold was chosen on: other towns, streets, beams, heights and speeds."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from envpred.build import check_motion
from envpred.build.check import check
from envpred.drives import Drive, find_drives, one_drive
from envpred.mapping import scan_matching
from envpred.mapping.geometry import FloatArray
from envpred.mapping.scan_matching import Target
from tests.build.harm import (
    CAMERA,
    CAR_POSES,
    DEGREE,
    NED,
    TUM,
    Change,
    inverted,
    poses,
    same,
    scans,
    turned,
    units,
    without,
)  # fmt: skip
from tests.drives import own

pytestmark = pytest.mark.slow

FRAMES = 60
LOW, HIGH, BUS = (0.2, 0.0, 0.6), (1.1, 0.2, 1.6), (0.9, -0.1, 2.1)  # of the sensor in the body frame, metres


class Base(NamedTuple):
    """A recording, and the faults that cannot be seen in it.

    Args:
        beams: of the scanner.
        seed: of the town and who drives in it.
        town: its number.
        pace: m/s.
        place: of the sensor in the body.
        kinds: of faults that there can be.
        missed: of them, those that are not found.
    """

    beams: int
    seed: int
    town: int
    pace: float
    place: tuple[float, float, float]
    kinds: str
    missed: tuple[str, ...] = ()


BASES = {
    "old town": Base(32, 61, 0, 8.0, LOW, "ground frame clock bent"),
    "suburb, fast, on a bus": Base(32, 63, 3, 16.0, BUS, "ground frame clock bent"),
    "boulevard, fast": Base(32, 65, 2, 16.0, LOW, "ground frame clock bent", ("no ground",)),
    "boulevard, 128 beams": Base(128, 62, 2, 8.0, HIGH, "ground frame clock bent"),
    "suburb, walking pace": Base(32, 73, 3, 1.4, LOW, "ground frame", ("NED",)),
    "old town, standing": Base(32, 82, 0, 0.0, HIGH, "ground"),
}


class Fault(NamedTuple):
    """A name, how it is made and said, and what it is to be called."""

    name: str
    change: Change
    said: dict[str, Any]
    what: str


def tilted(axis: str, degrees: float) -> Change:
    return turned(Rotation.from_euler(axis, degrees, degrees=True).as_matrix())


def faults(base: Base) -> Iterator[Fault]:
    """The faults that there can be in a recording of its kind."""
    height = own.above_road(np.array(base.place))
    if "ground" in base.kinds:
        yield Fault("upside down", turned(np.diag([1, -1, -1])), CAR_POSES, "scan upside down")
        yield Fault("on its side", turned([[1, 0, 0], [0, 0, -1], [0, 1, 0]]), CAR_POSES, "wrong axes")
        yield Fault("no ground", scans(lambda p: p[p[:, 2] > -0.6]), {}, "no ground found")
        for off in (-0.6, 0.6):
            said = {"sensor": {"height": height + off, "place": list(base.place)}}
            yield Fault(f"height {off}", same, said, "wrong height")
        yield Fault("rolled", tilted("x", 8), CAR_POSES, "sensor tilted")
        yield Fault("pitched", tilted("y", -7), CAR_POSES, "sensor tilted")
        yield Fault("gap", without, {}, "gaps")
    if "frame" in base.kinds:
        yield Fault("millimetres", units(1000), {}, "poses in other units")
        yield Fault("degrees", units(1 / DEGREE / 0.656, 1 / DEGREE, 1), {}, "poses in other units")
        yield Fault("NED", poses(np.diag([1.0, -1, -1]), NED), {}, "poses in another frame")
        yield Fault("camera", poses(CAMERA, CAMERA), {}, "poses in another frame")
        yield Fault("inverse", inverted, {}, "poses in another frame")
    if "clock" in base.kinds:
        for clock in (0.2, -0.3, 0.5):
            yield Fault(f"clock {clock}", same, {"poses": {**TUM, "clock": clock}}, "clock offset")


@pytest.fixture(autouse=True)
def _matched_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same scans are matched once, wherever their poses say to begin: half of these faults are of poses alone."""
    known: dict[Any, Any] = {}

    def match(points: FloatArray, onto: Target, starts: FloatArray) -> tuple[FloatArray, float]:
        key = points.tobytes(), onto.points.tobytes()
        if key not in known:
            known[key] = scan_matching.match(points, onto, starts)
        found: tuple[FloatArray, float] = known[key]
        return found

    monkeypatch.setattr(check_motion, "match", match)


def record(base: Base, moves: bool = False) -> own.Recorded:
    return own.record(FRAMES, base.beams, 720, moves, base.seed, base.town, base.pace, base.place)


def found_in(drive: Drive) -> list[str]:
    return [finding.what for finding in check(drive).findings]


@pytest.mark.parametrize("name", BASES)
def test_faults_of_other_recordings_are_found(tmp_path: Path, name: str) -> None:
    """All but those that the recording cannot show, and nothing in the same recording unharmed."""
    base = BASES[name]
    recorded, missed = record(base), []
    sound = check(one_drive(own.write(tmp_path / "sound", recorded)))
    assert sound.findings == []
    assert any("were not compared" in note for note in sound.notes) == ("clock" not in base.kinds)
    for fault in faults(base):
        folder = own.write(tmp_path / fault.name, fault.change(recorded), settings=fault.said)
        if fault.what not in found_in(one_drive(folder)):
            missed.append(fault.name)
    if "bent" in base.kinds:
        bent = record(base, moves=True)
        straight = {"deskew": {"by": "time", "stamp": "start"}}
        if found_in(one_drive(own.write(tmp_path / "bent", bent))) != ["motion within the sweep"]:
            missed.append("bent")
        assert found_in(one_drive(own.write(tmp_path / "straight", bent, ".bin", straight, with_time=True))) == []
    assert missed == list(base.missed)


def as_folder(drive: Drive, folder: Path, **said: Any) -> Path:
    """A KITTI drive as a folder of scans and TUM's poses of the body."""
    folder.mkdir()
    where = drive.folder / "velodyne_points" / "data"  # type: ignore[attr-defined]
    quaternions = Rotation.from_matrix(drive.poses[:, :3, :3]).as_quat()
    np.savetxt(folder / "path.txt", np.column_stack([drive.times, drive.poses[:, :3, 3], quaternions]), "%.9f")
    np.savetxt(folder / "times.txt", drive.times, "%.9f")
    settings = {
        "sensor": {"height": drive.sensor_height, "place": drive.sensor_to_body()[:3, 3].tolist()},
        "scans": {"folder": str(where)},
        "poses": {"format": "tum", "file": "path.txt", "of": "body"},
        "times": {"file": "times.txt"},
    }
    for key, values in said.items():
        settings[key] = {**settings[key], **values}
    (folder / "envpred.yaml").write_text(yaml.safe_dump(settings))
    return folder


LIES: dict[str, tuple[dict[str, Any], str]] = {
    "upside down": ({"scans": {"axes": ["forward", "right", "down"]}}, "scan upside down"),
    "millimetres": ({"poses": {"scale": 1000.0}}, "poses in other units"),
    "inverse": ({"poses": {"inverse": True}}, "poses in another frame"),
    "clock": ({"poses": {"clock": 0.3}}, "clock offset"),
}


@pytest.mark.parametrize("number", ["0005", "0013"])
def test_faults_of_the_real_drives_are_found(kitti: Path, tmp_path: Path, number: str) -> None:
    """As a folder of anybody's, whose settings lie, all but their clock; and nothing where they tell the truth."""
    (drive,) = [drive for drive in find_drives(kitti) if number in drive.name]
    assert found_in(one_drive(as_folder(drive, tmp_path / "sound"))) == []
    found = {lie: found_in(one_drive(as_folder(drive, tmp_path / lie, **said))) for lie, (said, _) in LIES.items()}
    assert [lie for lie, (_, what) in LIES.items() if what not in found[lie]] == ["clock"]
