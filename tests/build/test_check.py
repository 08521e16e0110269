"""Each fault of a recording is injected into a simulated one, and named with what mends it; sound ones give nothing."""

import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from envpred.build.check import check
from envpred.cli import main
from envpred.drives import find_drives, one_drive
from envpred.mapping.geometry import FloatArray
from tests.drives import own, synthetic

FRAMES = 60
Change = Callable[[own.Recorded], own.Recorded]
TUM = {"format": "tum", "file": "path.txt"}
NED = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1.0]])
CAMERA = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0.0]])  # its axes x right, y down, z forward, along the car's


@pytest.fixture(scope="module")
def recorded() -> own.Recorded:
    return own.record(FRAMES)


def scans(change: Callable[[np.ndarray], np.ndarray]) -> Change:
    return lambda r: r._replace(scans=[change(points).astype(np.float32) for points in r.scans])


def turned(rotation: Any) -> Change:
    matrix = np.array(rotation, np.float64)
    return scans(lambda points: np.column_stack([points[:, :3] @ matrix.T, points[:, 3]]))


def poses(axes: FloatArray, world: FloatArray) -> Change:
    """Poses of a frame whose axes are the columns of `axes`, in a world whose axes are the columns of `world`."""

    def change(r: own.Recorded) -> own.Recorded:
        left, right = np.eye(4), np.eye(4)
        left[:3, :3], right[:3, :3] = world.T, axes
        return r._replace(body=left @ r.sensor @ right @ np.linalg.inv(own.offset()))

    return change


def units(number: float) -> Change:
    """Poses of so many units a metre."""

    def change(r: own.Recorded) -> own.Recorded:
        sensor = r.sensor
        sensor[:, :3, 3] *= number
        return r._replace(body=sensor @ np.linalg.inv(own.offset()))

    return change


def inverted(r: own.Recorded) -> own.Recorded:
    return r._replace(body=np.linalg.inv(r.sensor) @ np.linalg.inv(own.offset()))


def same(r: own.Recorded) -> own.Recorded:
    return r


def without(r: own.Recorded) -> own.Recorded:
    kept = [k for k in range(FRAMES) if not 20 <= k < 24]
    return own.Recorded([r.scans[k] for k in kept], [r.since[k] for k in kept], r.body[kept], r.times[kept])


def moving(r: own.Recorded) -> own.Recorded:
    return own.record(FRAMES, moves=True)


CAR_POSES = {"poses": {**TUM, "axes": ["forward", "left", "up"]}}
LOW = {"sensor": {"height": 1.2, "place": own.PLACE.tolist()}}
PITCHED = [[0.9848, 0, 0.1736], [0, 1, 0], [-0.1736, 0, 0.9848]]
# The fault, how it is written, what is said of it, and a pattern of what mends it.
FAULTS: dict[str, tuple[Change, dict[str, Any], str, str]] = {
    "upside down": (
        *(turned(np.diag([1, -1, -1])), CAR_POSES, "scan upside down"),
        r"scans: \{axes: \[forward, right, down\]\}, poses: \{axes: \[forward, left, up\]\}",
    ),
    "on its side": (
        *(turned([[1, 0, 0], [0, 0, -1], [0, 1, 0]]), CAR_POSES, "wrong axes"),
        r"scans: \{axes: \[forward, down, left\]\}, poses: \{axes: \[forward, left, up\]\}",
    ),
    "x right, y forward": (
        *(turned([[0, -1, 0], [1, 0, 0], [0, 0, 1]]), {}, "wrong axes"),
        r"scans: \{axes: \[right, forward, up\]\}, poses: \{axes: \[forward, left, up\]\}",
    ),
    "no ground": (scans(lambda p: p[p[:, 2] > -1.5]), {}, "no ground found", "give whole scans"),
    "another height": (same, LOW, "wrong height", r"sensor: \{height: 2\.0[789]\}"),
    "tilted": (turned(PITCHED), CAR_POSES, "sensor tilted", r"sensor: \{angles: \[-?0\.\d, -(9|10)\.\d, 0\]\}"),
    "millimetres": (units(1000), {}, "poses in other units", r"poses: \{scale: 0\.001\}"),
    "kilometres": (units(0.001), {}, "poses in other units", r"poses: \{scale: 1000\}"),
    "feet": (units(1 / 0.3048), {}, "poses in other units", r"poses: \{scale: 0\.3048\}"),
    "north, east, down": (
        *(poses(np.diag([1.0, -1, -1]), NED), {}, "poses in another frame"),
        r"poses: \{axes: \[forward, right, down\], world: \[north, east, down\]\}",
    ),
    "camera": (
        *(poses(CAMERA, CAMERA), {}, "poses in another frame"),
        r"poses: \{axes: \[right, down, forward\], world: \[south, down, east\]\}",
    ),
    "world to car": (inverted, {}, "poses in another frame", r"poses: \{inverse: true\}"),
    "clock ahead": (same, {"poses": {**TUM, "clock": 0.2}}, "clock offset", r"poses: \{clock: -?0\.0[0-2]\}"),
    "clock behind": (same, {"poses": {**TUM, "clock": -0.3}}, "clock offset", r"poses: \{clock: -?0\.0[0-2]\}"),
    "gap": (without, {}, "gaps", "1 in 56 frames, the longest 0.5 s after frame 19, .*copy the scans"),
    "motion within the sweep": (
        *(moving, {}, "motion within the sweep"),
        r"deskew: \{by: azimuth, turn: counterclockwise\}",
    ),
}


def found_in(folder: Path) -> list[tuple[str, str]]:
    return [(finding.what, str(finding)) for finding in check(one_drive(folder)).findings]


def test_scans_and_poses_of_other_days_are_said(tmp_path: Path) -> None:
    folder = own.write(tmp_path / "mine", own.record(4), ".npy", {"poses": {**TUM, "clock": 1e6}})
    (finding,) = check(one_drive(folder)).findings
    assert "mine: no frame has both a scan and a pose; check names, times and clocks of both" in str(finding)


@pytest.mark.slow
def test_a_sound_recording_has_nothing(recorded: own.Recorded, tmp_path: Path) -> None:
    assert found_in(own.write(tmp_path / "mine", recorded)) == []
    straightened = {"deskew": {"by": "time", "stamp": "start"}}
    bent = own.write(tmp_path / "bent", moving(recorded), ".bin", straightened, with_time=True)
    assert found_in(bent) == []


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_named_with_what_mends_it(recorded: own.Recorded, tmp_path: Path, fault: str) -> None:
    change, said, what, mends = FAULTS[fault]
    folder = own.write(tmp_path / "mine", change(recorded), settings=said)
    ((named, told),) = found_in(folder)
    assert named == what
    assert re.search(mends, told)


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["upside down", "camera", "north, east, down", "world to car", "feet"])
def test_what_is_named_mends(recorded: own.Recorded, tmp_path: Path, fault: str) -> None:
    """The settings that the finding says are written, and nothing is found any more."""
    change, said, *_ = FAULTS[fault]
    folder = own.write(tmp_path / "mine", change(recorded), settings=said)
    ((_, told),) = found_in(folder)
    mends = yaml.safe_load("{" + told.split("write `")[1].split("`")[0] + "}")
    file = folder / "envpred.yaml"
    settings = yaml.safe_load(file.read_text())
    for key, values in mends.items():
        settings[key] = {**settings[key], **values}
    file.write_text(yaml.safe_dump(settings))
    assert found_in(folder) == []


@pytest.mark.slow
@pytest.mark.parametrize("number", ["0005", "0013"])
def test_the_real_drives_have_nothing(kitti: Path, number: str) -> None:
    (drive,) = [drive for drive in find_drives(kitti) if number in drive.name]
    assert check(drive).findings == []


@pytest.mark.slow
@pytest.mark.parametrize("beams", [16, 64, 128])
def test_other_scanners_have_nothing(tmp_path: Path, beams: int) -> None:
    assert found_in(own.write(tmp_path / "mine", own.record(FRAMES, beams))) == []


def test_the_command_says_it_and_draws(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A street whose scans are upside down beside one that has lost its poses, and one that is sound."""
    monkeypatch.chdir(tmp_path)
    body = synthetic.motion(14, speed=6.0, weave=0.3)
    street = own.Recorded(list(synthetic.scans(body, 0.0, 180)), [], body, np.asarray(0.1 * np.arange(14), np.float64))
    street = street._replace(since=[np.zeros(len(points)) for points in street.scans])
    height = {"sensor": {"height": 1.73}, "poses": {**TUM, "of": "body"}}
    own.write(tmp_path / "drives" / "sound", street, settings=height)
    down = turned(np.diag([1, -1, -1]))(street)
    own.write(tmp_path / "drives" / "down", down, settings=height)
    shutil.copytree(tmp_path / "drives" / "sound", tmp_path / "drives" / "posed")
    (tmp_path / "drives" / "posed" / "path.txt").unlink()
    with pytest.raises(SystemExit) as stop:
        main(["check", "drives"])
    assert stop.value.code == 1
    said = capsys.readouterr()
    assert re.search(
        r"down: scan upside down: the road lies 1.\d+ m above the sensor; write `scans: .axes: \[forw", said.out
    )
    assert "posed: cannot be read: " in said.out
    assert "path.txt: missing; name the right file" in said.out
    assert "sound: 14 frames, nothing looks wrong" in said.out
    assert said.err == "envpred: 2 of 3 drives look wrong; what mends them is said above\n"
    assert {file.name for file in (tmp_path / "check").iterdir()} == {"down.png", "sound.png"}
    assert (tmp_path / "check" / "down.png").stat().st_size > 10_000
    main(["check", "drives", "--drives", "[sound]", "--out", "alone"])
    assert capsys.readouterr().out.endswith("alone/sound.png\n")
    with pytest.raises(SystemExit):
        main(["check", "drives", "--drives=[none]"])
    assert "--drives: drives has no drive none; it has down, posed, sound" in capsys.readouterr().err
