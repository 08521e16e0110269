"""The page that plays a replay: what it holds, and every control of it in a real browser."""

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from envpred.cli import main
from envpred.drives import Drive
from envpred.live.player import LEVELS, Player
from envpred.live.replay import Latency, Step, replay
from envpred.live.stream import Stream
from envpred.mapping.evidence import pignistic
from envpred.mapping.geometry import OCCUPIED
from envpred.models import RolloutForecaster
from tests.browser import BROWSER, FLAGS
from tests.drives.synthetic import packet, write_drive
from tests.live.replays import FRAMES, GAP, GRID, forecast_frames, unpacked
from tests.remedies import refusal, remedy

HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def played(drive: Drive, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Step]]:
    """A page, and the replay that it shows."""
    stream = Stream.of(RolloutForecaster(futures=4), drive, grid=GRID, warn=lambda said: None)
    player = Player(stream, drive.name, "rollout & <more>", FRAMES, FRAMES)
    steps = list(replay(stream, drive, Latency()))
    assert [drive.frames.index(step.frame) for step in steps if step.forecast is not None] == forecast_frames()
    again = Stream.of(RolloutForecaster(futures=4), drive, grid=GRID, warn=lambda said: None)
    player.stream = again
    for step in replay(again, drive, Latency()):
        player.add(step)
    return player.write(tmp_path_factory.mktemp("page") / "live.html"), steps


def content(page: Path) -> dict[str, Any]:
    """The data of a page."""
    found = re.search(
        r'<script id="data" type="application/json">(.*?)</script>', page.read_text(encoding="utf-8"), re.DOTALL
    )
    assert found
    data: dict[str, Any] = json.loads(found[1])
    return data


def test_the_page_holds_what_was_forecast_and_what_came(played: tuple[Path, list[Step]]) -> None:
    page, steps = played
    data = content(page)
    grids = unpacked(data["grids"]).reshape(-1, 64, 64)
    assert len(grids) == len(data["places"]) == FRAMES - 1
    for step, grid, place in zip(steps, grids, data["places"], strict=True):
        assert step.mapped is not None
        assert np.abs(grid / LEVELS - pignistic(step.mapped.mass)).max() <= 0.5 / LEVELS + 1e-6
        assert place[:3] == pytest.approx([step.mapped.time, *step.mapped.pose[:2, 3]], abs=1e-4)
    assert [shown["at"] for shown in data["shown"]] == forecast_frames()
    for shown in data["shown"]:
        step = steps[shown["at"]]
        assert step.forecast is not None
        forecast = unpacked(shown["forecast"]).reshape(-1, 64, 64)
        assert np.abs(forecast / LEVELS - step.forecast.probability).max() <= 0.5 / LEVELS + 1e-6
        assert np.shape(shown["futures"]) == (4, 15, 2)
        scan = unpacked(shown["scan"]).reshape(128, 128)
        assert set(np.unique(scan)) == {0, 1, 2}
    first, last = data["shown"][0], data["shown"][-1]
    known = len([t for t in range(5, GAP) if t <= 4 + 15])
    assert [value is not None for value in first["mse"]] == [True] * known + [False] * (15 - known)
    came = pignistic(steps[9].mapped.mass)  # type: ignore[union-attr]
    assert first["mse"][4] == pytest.approx(np.mean((steps[4].forecast.probability[4] - came) ** 2), rel=0.01)  # type: ignore[union-attr]
    assert last["mse"] == [None] * 15


def test_the_scan_lies_on_the_grid(played: tuple[Path, list[Step]]) -> None:
    """Where a scan shows obstacles, its label grid is occupied, but for the border of cells."""
    page, steps = played
    for shown in content(page)["shown"][:3]:
        obstacles = (unpacked(shown["scan"]).reshape(64, 2, 64, 2) == 2).any(axis=(1, 3))
        mapped = steps[shown["at"]].mapped
        assert mapped is not None
        occupied = mapped.label == OCCUPIED
        assert obstacles[occupied].mean() > 0.95
        assert occupied[obstacles].mean() > 0.95


def use(page: Path, width: int, folder: Path) -> dict[str, Any]:
    """What the page shows while all its controls are used."""
    assert BROWSER is not None
    probed = folder / "probed.html"
    watch, controls = (f"<script>{(HERE / name).read_text('utf-8')}</script>" for name in ("watch.js", "use.js"))
    text = page.read_text(encoding="utf-8").replace('<meta name="viewport"', f'{watch}<meta name="viewport"', 1)
    probed.write_text(text.replace("</body>", f"{controls}</body>"))
    size = [f"--window-size={width},1000", "--virtual-time-budget=20000", f"--user-data-dir={folder / 'profile'}"]
    done = subprocess.run(
        [BROWSER, *FLAGS, *size, "--dump-dom", probed.as_uri()], check=True, capture_output=True, text=True, timeout=180
    )
    found = re.search(r'<script type="application/json" id="probe">(.*?)</script>', done.stdout, re.DOTALL)
    assert found, done.stdout[-500:]
    seen: dict[str, Any] = json.loads(found[1])
    return seen


@pytest.mark.skipif(BROWSER is None, reason="no browser: install chromium")
@pytest.mark.parametrize(("width", "columns"), [(1400, 3), (400, 2)])
def test_every_control_of_the_page(played: tuple[Path, list[Step]], width: int, columns: int, tmp_path: Path) -> None:
    page, _ = played
    data, seen = content(page), use(page, width, tmp_path)
    assert seen["problems"] == []
    assert seen["loaded"] == []
    assert seen["wide"] <= 0
    assert seen["columns"] == columns
    last, grids = len(data["shown"]) - 1, unpacked(data["grids"])
    assert seen["grids"] == [len(grids), int(grids.sum())]
    forecast = unpacked(data["shown"][0]["forecast"])
    assert seen["forecast"] == [len(forecast), int(forecast.sum())]
    assert seen["start"][:4] == [0, 5, "0.40 s", "0.5 s"]
    assert seen["start"][4].startswith(f"error {data['shown'][0]['mse'][4]:.3g}"[:9])
    assert seen["start"][5] == "at 0.90 s"
    assert [tuple(state[:2]) for state in seen["keys"]] == [
        (1, 5),
        (1, 6),
        (1, 5),
        (0, 5),
        (last, 5),
        (last, 5),
        (0, 5),
    ]
    assert [tuple(state[:2]) for state in seen["slid"]] == [(3, 5), (3, 15), (3, 0)]
    assert seen["slid"][1][3:] == ["1.5 s", "", "the recording ends, or has a gap"]
    assert all(seen["panels"][name] != seen["other"][name] for name in seen["panels"])
    assert seen["clicked"][0][0] == 4
    assert seen["clicked"][1][0] == 3
    assert seen["label"] == "Stop"
    assert seen["played"] > 5  # twice as fast as ten frames a second
    assert seen["stopped"][0] == "Play"
    assert seen["still"] == seen["stopped"][1]
    assert seen["last"][5] == "the recording ends, or has a gap"
    assert len(set(seen["blank"])) == 2


def test_the_page_names_nothing_outside_itself(played: tuple[Path, list[Step]]) -> None:
    text = played[0].read_text(encoding="utf-8")
    assert not re.findall(r'(?:src|href)="(?!data:)', text)
    assert "default-src 'none'" in text
    assert "<h1>2011_09_26_drive_0001_sync: rollout &amp; &lt;more&gt;</h1>" in text


def test_fewer_frames_make_a_smaller_page(drive: Drive, tmp_path: Path) -> None:
    stream = Stream.of(RolloutForecaster(futures=4), drive, grid=GRID, warn=lambda said: None)
    player = Player(stream, drive.name, "rollout", len(drive.frames), 5)
    for step in replay(stream, drive, Latency()):
        player.add(step)
    data = content(player.write(tmp_path / "live.html"))
    assert [shown["at"] for shown in data["shown"]] == [6, 12, 24]  # every sixth of 29 scans, where there is a forecast
    assert len(data["places"]) == len(drive.frames)


def test_live_writes_a_page_and_tells_how_long_it_took(
    drive: Drive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    source = str(drive.folder.parents[1])  # type: ignore[attr-defined]
    main(["live", source, "--config=last_frame", "--grid.cells=32", "--out=pages/live.html", "--frames=9"])
    said = capsys.readouterr()
    assert "warning: no scan for 0.20 s before 1.90 s: evidence starts anew" in said.err
    lines = said.out.splitlines()
    assert lines[0].startswith("2011_09_26_drive_0001_sync: 29 scans, 21 forecasts, 0 scans dropped, ")
    assert [line.split("  ")[0] for line in lines[1:-1]] == [
        *("", "read", "ground", "label", "evidence", "forecast", "scan to forecast")
    ]
    assert lines[-1] == "pages/live.html"
    assert len(content(Path("pages/live.html"))["shown"]) == 6
    assert [file.name for file in tmp_path.iterdir()] == ["pages"]


def test_live_takes_weights_that_ship_by_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_drive(tmp_path, frames=7)
    weights = ["live", str(tmp_path), "--weights=prednet_dst_static"]
    said = refusal([*weights, "--config=last_frame"])
    assert said == "--weights prednet_dst_static says which forecaster: leave --config=last_frame out"
    (left_out,) = remedy(said)
    assert left_out == ["--config=last_frame"]
    main(weights)
    assert ": 7 scans, 3 forecasts, 0 scans dropped, " in capsys.readouterr().out


def test_who_is_late_drops_scans(drive: Drive, monkeypatch: pytest.MonkeyPatch) -> None:
    """By a clock of the test's own: each scan takes two and a half periods."""
    clock = [0.0]
    monkeypatch.setattr("envpred.live.replay.time.monotonic", lambda: clock[0])
    monkeypatch.setattr("envpred.live.replay.time.sleep", lambda seconds: clock.__setitem__(0, clock[0] + seconds))
    latency = Latency()
    stream = Stream.of(RolloutForecaster(), drive, grid=GRID, warn=lambda said: None)
    monkeypatch.setattr(stream, "update", lambda *scan: clock.__setitem__(0, clock[0] + 0.25))
    frames = [step.frame for step in replay(stream, drive, latency, at_rate=True)]
    assert frames[:5] == [0, 2, 5, 7, 10]
    assert latency.scans + latency.dropped == len(drive.frames)


def test_what_live_refuses(drive: Drive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    source = str(drive.folder.parents[1])  # type: ignore[attr-defined]
    assert refusal(["live", source, "--config=last_frame", "--out=a.png"]) == (
        "--out a.png: end its name on .html for a page, or on .rrd for a recording"
    )
    said = refusal(["live", source, "--grid.cells=32"])
    assert said == "say which forecaster: give --config rollout, or another that `envpred configs` lists"
    (option, command) = remedy(said)
    main(command)
    main(["live", source, "--grid.cells=32", *option])
    assert refusal(["live", source, "--config=prednet_small"]).startswith("the weights of PredNetForecaster must come")
    assert "did you mean prednet_dst_static?" in refusal(["live", source, "--weights=prednet_dst_statik"])
    (tmp_path / "a.ckpt").write_bytes(b"nothing")
    assert "holds more than weights, so it is not loaded" in refusal(["live", source, "--ckpt_path=a.ckpt"])
    poseless = write_drive(tmp_path / "drives", frames=3)
    shutil.rmtree(poseless / "oxts")
    assert "no OXTS packets; unpack the drive's oxts folder there" in refusal(["live", "drives", "--config=last_frame"])
    (poseless / "oxts" / "data").mkdir(parents=True)
    (poseless / "oxts" / "data" / "0000000007.txt").write_text(packet(np.eye(4)))
    assert refusal(["live", "drives", "--config=last_frame"]) == (
        "2011_09_26_drive_0001_sync: no frame has both a scan and a pose; check that both are unpacked"
    )
