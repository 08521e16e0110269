"""The simulator's commands, from the command line to their files."""

import re
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import NoReturn

import pytest

from envpred.cli import main
from envpred.simulate import commands, record, run
from envpred.simulate.presets import PRESETS, SCAN_BYTES
from envpred.simulate.run import builtin_recording
from envpred.simulate.traffic import Recording
from tests.drives.synthetic import write_drive, write_sequence
from tests.remedies import refusal, remedy


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `envpred scan` asks for where it is given drives that nobody simulated."""
    root = tmp_path_factory.mktemp("simulated")
    write_drive(root / "raw", frames=2)
    write_sequence(root / "odometry", frames=2)
    commands = []
    for source, line in (("raw", "only drives of `envpred simulate` know"), ("odometry", "no simulated drive")):
        message = refusal(["scan", "--source", str(root / source), "--out", "x.png"])
        assert line in message
        commands.append(remedy(message))
    assert commands[0] == commands[1]
    ((command,),) = commands[0]
    main([command, str(root / "drives"), "--drives", "1", "--frames", "6", "--seed", "5", "--workers", "1"])
    return root / "drives"


def test_pictures_of_scan_and_traffic(simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["scan", "--source", str(simulated), "--frame", "2", "--out", str(tmp_path / "scan.png")])
    main(["traffic", "--town", "1", "--second", "20", "--out", str(tmp_path / "traffic.png")])
    printed = capsys.readouterr().out.split()
    for name in ("scan.png", "traffic.png"):
        assert str(tmp_path / name) in printed
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")


def test_realism_prints_both(simulated: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["realism", "--simulated", str(simulated), "--real", str(simulated)])
    rows = {line[:34].strip(): line[34:].replace("|", "").split() for line in capsys.readouterr().out.splitlines()}
    low, middle, high, real = (float(v) for v in rows["points a scan"][:4])
    assert low == middle == high == real > 50_000


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["traffic", "--town", "99", "--out", "x.png"], "--town 99: the recording has"),
        (["traffic", "--second", "1e6", "--out", "x.png"], "--second 1e\\+06: the recording lasts"),
        (["traffic", "--recording", "nowhere.npz", "--out", "x.png"], "nowhere.npz"),
        (["scan", "--source", "{simulated}", "--drive", "mine", "--out", "x.png"], "no drive named mine"),
        (["traffic", "--second", ".nan", "--out", "x.png"], "--second nan: the recording lasts"),
        (["traffic", "--town", "-1", "--out", "x.png"], "--town -1: the recording has"),
        (["scan", "--source", "{simulated}", "--frame", "60", "--out", "x.png"], "has no frame 60; it has 0 to 5"),
        (["scan", "--source", "{simulated}", "--frame", "-1", "--out", "x.png"], "has no frame -1; it has 0 to 5"),
        (["record", "x.npz", "--seconds", ".nan"], "--seconds nan: give a number of at least 10"),
        (["record", "x.npz", "--seconds", ".inf"], "--seconds inf: give a number of at least 10"),
        (["record", "x.npz", "--seed", "-1"], "--seed -1: give a number of at least 0"),
        (["record", "{simulated}/2020_01_01/calib_velo_to_cam.txt/x.npz"], "is no folder; name another place"),
        (["realism", "--simulated", "{simulated}", "--real", "nowhere"], "nowhere"),
    ],
)
def test_wrong_arguments_are_one_line(
    simulated: Path, arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        main([argument.format(simulated=simulated) for argument in arguments])
    assert stop.value.code == 1
    error = capsys.readouterr().err
    assert len(error.strip().splitlines()) == 1

    assert re.search(words, error)


class StartedError(Exception):
    """The drives would be made now."""


def start(*_: object) -> NoReturn:
    raise StartedError


def test_a_longer_recording_and_fewer_drives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is asked for when a recording is too short, or the disk too small."""
    monkeypatch.setattr(run, "run_jobs", start)
    short = Recording.load(builtin_recording())
    tracks = [replace(track, places=track.places[:5]) for track in short.networks[0].tracks]
    Recording(short.interval, short.seconds, [replace(short.networks[0], tracks=tracks)]).save(tmp_path / "short.npz")
    args = ["simulate", str(tmp_path / "drives"), "--drives=2", "--frames=90"]
    ((recording,),) = remedy(refusal([*args, f"--recording={tmp_path / 'short.npz'}"]))
    args.append(f"{recording}={builtin_recording()}")
    with pytest.raises(StartedError):
        main(args)
    shutil.rmtree(tmp_path / "drives")
    with monkeypatch.context() as small:
        free = 100 * SCAN_BYTES
        small.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=free))
        fewer = remedy(refusal(args))
        assert len(fewer) == 2
        for (option,) in fewer:
            with pytest.raises(StartedError):
                main([*args, f"{option}={50 if 'frames' in option else 1}"])
            shutil.rmtree(tmp_path / "drives")


def test_a_recording_is_never_overwritten(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[Path, float, int]] = []
    monkeypatch.setattr(record, "record", lambda *arguments: asked.append(arguments))
    commands.record(tmp_path / "new.npz", seconds=30, seed=4)
    assert asked == [(tmp_path / "new.npz", 30, 4)]
    before = builtin_recording().read_bytes()
    with pytest.raises(Exception, match="is there already"):
        commands.record(builtin_recording())
    assert builtin_recording().read_bytes() == before


def test_a_preset_tells_its_plan_and_needs_its_place_before_anything_is_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=10**9))
    monkeypatch.setattr(run, "run_jobs", lambda job, todo, *_: made.extend(todo))
    made: list[run.Planned] = []
    told: list[str] = []
    monkeypatch.setattr(run, "say", told.append)
    message = refusal(["simulate", str(tmp_path / "out"), "--preset", "train"])
    assert message.endswith(
        "the drives need about 26.5 GB, 1.0 GB are free; ask for fewer --drives or --frames, or give another disk"
    )
    assert list(tmp_path.iterdir()) == []
    assert "plan: 60 drives of 170 scans, 10,200 in all; seed 0, hash " in told[0]
    main(["simulate", str(tmp_path / "out"), "--preset", "train", "--drives", "2"])
    assert [len(drive.frames) for drive in made] == [PRESETS["train"].frames] * 2
