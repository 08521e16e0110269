"""The simulator's commands, from the command line to their files."""

import re
from pathlib import Path

import pytest

from envpred.cli import main
from envpred.simulate import commands, record
from envpred.simulate.run import builtin_recording


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("simulated") / "drives"
    main(["simulate", str(out), "--drives", "1", "--frames", "6", "--seed", "5", "--workers", "1"])
    return out


def test_pictures_of_scan_and_traffic(simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["scan", "--source", str(simulated), "--frame", "2", "--out", str(tmp_path / "scan.png")])
    main(["traffic", "--town", "1", "--second", "20", "--out", str(tmp_path / "traffic.png")])
    printed = capsys.readouterr().out.split()
    for name in ("scan.png", "traffic.png"):
        assert str(tmp_path / name) in printed
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")


def test_realism_prints_both(simulated: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["realism", "--simulated", str(simulated), "--real", str(simulated)])
    rows = {line[:28].strip(): line[28:].replace("|", "").split() for line in capsys.readouterr().out.splitlines()}
    mean, least, largest, real = (float(v) for v in rows["points a scan"])
    assert mean == least == largest == real > 50_000


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["traffic", "--town", "99", "--out", "x.png"], "--town 99: the recording has"),
        (["traffic", "--second", "1e6", "--out", "x.png"], "--second 1e\\+06: the recording lasts"),
        (["traffic", "--recording", "nowhere.npz", "--out", "x.png"], "nowhere.npz"),
        (["scan", "--source", "{simulated}", "--drive", "mine", "--out", "x.png"], "no drive named mine"),
        (["scan", "--source", "{simulated}", "--frame", "60", "--out", "x.png"], "0000000060.bin"),
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


def test_a_real_drive_has_no_classes_to_draw(simulated: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for file in simulated.glob("*/*/labels/0000000003.label"):
        file.unlink()
    with pytest.raises(SystemExit):
        main(["scan", "--source", str(simulated), "--frame", "3", "--out", "x.png"])
    assert "only drives of `envpred simulate` know the class" in capsys.readouterr().err


def test_a_recording_is_never_overwritten(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[Path, float, int]] = []
    monkeypatch.setattr(record, "record", lambda *arguments: asked.append(arguments))
    commands.record(tmp_path / "new.npz", seconds=30, seed=4)
    assert asked == [(tmp_path / "new.npz", 30, 4)]
    before = builtin_recording().read_bytes()
    with pytest.raises(Exception, match="is there already"):
        commands.record(builtin_recording())
    assert builtin_recording().read_bytes() == before
