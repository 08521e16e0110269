"""Recordings for Rerun, read back by Rerun's own reader."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from envpred.cli import main
from envpred.drives import Drive
from envpred.drives.tracklets import TRACKLETS, VISIBLE, Tracklet
from envpred.live.recording import EVERY, recording
from envpred.live.replay import Latency, Step, replay
from envpred.live.stream import Stream
from envpred.mapping.dogma import DogmaParameters
from envpred.mapping.evidence import pignistic
from envpred.mapping.particle_state import ParticleFilterParameters
from envpred.models import RolloutForecaster
from envpred.simulate.tracklets import write
from tests.live.replays import GRID, forecast_frames, small_drive
from tests.remedies import installs, refusal, remedy

chunk = pytest.importorskip("rerun.chunk")

FEW = DogmaParameters(ParticleFilterParameters(persistent=2000, births=200, frame="ground"))


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    """With a box at the frames up to the fifth."""
    drive = small_drive(tmp_path_factory.mktemp("drives"))
    car = Tracklet("Car", (4.0, 2.0, 1.5), 0, [(3.0, 1.0, -1.7, np.pi / 2)] * 6, [VISIBLE] * 6)
    write(drive.folder / TRACKLETS, [car])  # type: ignore[attr-defined]
    return drive


def stream_of(drive: Drive) -> Stream:
    return Stream.of(
        RolloutForecaster(movers=True, futures=2), drive, grid=GRID, velocities=FEW, warn=lambda said: None
    )


def read(file: Path, views: bool = False) -> dict[str, list[dict[str, Any]]]:
    """The rows of a recording by entity, in order; or those of what the viewer shows at first."""
    found: dict[str, list[dict[str, Any]]] = {}
    reader = chunk.RrdReader(file)
    (store,) = reader.blueprints() if views else reader.recordings()
    for part in reader.stream(store=store).to_chunks():
        found.setdefault(part.entity_path, []).extend(part.to_record_batch().to_pylist())
    return {entity: sorted(rows, key=lambda row: str(row.get("scan_time", ""))) for entity, rows in found.items()}


def views(file: Path) -> dict[str, list[str]]:
    """What the views that a recording opens with show, by their names."""
    shown = read(file, views=True)
    named = {entity: row for entity, rows in shown.items() for row in rows if "ViewBlueprint:display_name" in row}
    return {
        row["ViewBlueprint:display_name"][0]: shown[f"{entity}/ViewContents"][0]["ViewContents:query"]
        for entity, row in named.items()
    }


def test_a_recording_holds_what_the_replay_came_to(drive: Drive, tmp_path: Path) -> None:
    file, stream, steps = tmp_path / "live.rrd", stream_of(drive), list[Step]()
    with recording(file, stream, drive) as add:
        for step in replay(stream, drive, Latency()):
            add(step)
            steps.append(step)
    found = read(file)
    assert {name for name in found if not name.startswith("/__")} == {
        *("/world", "/world/grid", "/world/velocities", "/world/sensor", "/world/forecast"),
        *(f"/world/sensor/{part}" for part in ("obstacles", "ground", "boxes", "ego")),
        *(f"/world/forecast/{ahead}" for ahead in ("0.1s", "0.5s", "1.0s", "1.5s")),
    }
    assert found["/__properties"][0]["RecordingInfo:name"] == [drive.name]
    assert views(file) == {
        "now": ["world/grid", "world/velocities", "world/sensor/**"],
        **{f"in {ahead} s": [f"world/forecast/{ahead}s", "world/sensor/ego"] for ahead in (0.1, 0.5, 1.0, 1.5)},
    }
    grids = found["/world/grid"]
    assert len(grids) == len(drive.frames) == len(found["/world/sensor/obstacles"])
    for step, row, points in zip(steps, grids, found["/world/sensor/obstacles"], strict=True):
        assert step.mapped is not None
        assert row["scan_time"].total_seconds() == pytest.approx(step.mapped.time, abs=1e-6)
        picture = np.frombuffer(bytes(row["GridMap:data"][0]), np.uint8).reshape(64, 64)
        percent = np.rint(100 * pignistic(step.mapped.mass)).astype(np.uint8)
        np.testing.assert_array_equal(picture[::-1].T, percent)  # a picture begins in the north
        assert row["GridMap:cell_size"] == pytest.approx([1 / 3])
        assert len(points["Points3D:positions"]) == -(-step.mapped.obstacle.sum() // EVERY["obstacles"])
        (colour,) = points["Points3D:colors"]  # seen on black and on white
        assert 50 < np.mean([colour >> place & 255 for place in (8, 16, 24)]) < 200
        middle = np.array(row["GridMap:translation"][0]) + 32 / 3
        assert np.abs(middle[:2] - step.mapped.pose[:2, 3]).max() < 0.5
    forecasts = found["/world/forecast/0.5s"]
    assert len(forecasts) == len(forecast_frames())
    step, row = steps[4], forecasts[0]
    assert step.forecast is not None
    picture = np.frombuffer(bytes(row["GridMap:data"][0]), np.uint8).reshape(64, 64)
    np.testing.assert_array_equal(picture[::-1].T, np.rint(100 * step.forecast.probability[4]).astype(np.uint8))
    assert row["GridMap:translation"][0][:2] == pytest.approx(step.forecast.origin[4], abs=1e-4)
    cleared = [row["scan_time"].total_seconds() for row in found["/world/forecast"]]  # or the last would still be shown
    assert cleared == pytest.approx([step.mapped.time for step in steps if step.mapped and not step.forecast], abs=1e-6)
    (ego,) = found["/world/sensor/ego"]
    size, middle = 2 * np.array(ego["Boxes3D:half_sizes"][0]), np.array(ego["Boxes3D:centers"][0])
    assert [*(middle - size / 2)] == pytest.approx([drive.body.rear, -drive.body.half_width, -drive.sensor_height])
    assert [*(middle + size / 2)] == pytest.approx([drive.body.front, drive.body.half_width, 0])
    shown = [row for row in found["/world/sensor/boxes"] if row.get("Boxes3D:labels")]
    assert len(shown) == 6
    assert shown[0]["Boxes3D:half_sizes"] == [pytest.approx([2, 1, 0.75])]
    assert shown[0]["Boxes3D:centers"] == [pytest.approx([3, 1, -0.95])]
    moving = sum(len(row["Arrows3D:vectors"] or []) for row in found["/world/velocities"])
    assert moving > 0


def test_a_recording_that_is_cut_short_leaves_nothing(drive: Drive, tmp_path: Path) -> None:
    stream = stream_of(drive)

    def cut_short() -> None:
        with recording(tmp_path / "live.rrd", stream, drive) as add:
            for step in replay(stream, drive, Latency(), frames=range(3)):
                add(step)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        cut_short()
    assert list(tmp_path.iterdir()) == []


def test_live_records_every_second_scan(drive: Drive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    source = str(drive.folder.parents[1])  # type: ignore[attr-defined]
    main(["live", source, "--config=last_frame", "--grid.cells=32", "--every=2", "--out=live.rrd,live.html"])
    found = read(Path("live.rrd"))
    assert views(Path("live.rrd"))["in 1.0 s"][0] == "world/forecast/1.0s"
    assert len(found["/world/forecast/1.0s"]) > 0
    assert len(found["/world/grid"]) == 14  # of thirty frames, one of which has no scan
    assert len([row for row in found["/world/sensor/boxes"] if row.get("Boxes3D:labels")]) == 3
    assert {file.name for file in tmp_path.iterdir()} == {"live.rrd", "live.html"}


def test_without_rerun_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    said = refusal(["live", str(tmp_path), "--config=last_frame", "--out=live.rrd"])
    assert said == "a recording (.rrd) needs Rerun: pip install 'envpred[viewer]'"
    assert installs(remedy(said)[0]) == {"rerun-sdk"}
