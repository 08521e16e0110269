"""Each fault of a recording is injected into a simulated one, and named with what mends it; sound ones give nothing."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

from envpred.build.check import check
from envpred.cli import main
from envpred.drives import find_drives, one_drive
from tests.build.harm import FAULTS as HARM
from tests.build.harm import TUM, Fault, turned
from tests.drives import own, synthetic

FRAMES = 60


@pytest.fixture(scope="module")
def recorded() -> own.Recorded:
    return own.record(FRAMES)


def moving(r: own.Recorded) -> own.Recorded:
    """The same drive, its scans bent by the ego's motion."""
    return own.record(FRAMES, moves=True)


BENT = Fault(moving, {}, "motion within the sweep", r"deskew: \{by: azimuth, turn: counterclockwise\}")
FAULTS = {**HARM, "motion within the sweep": BENT}


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
