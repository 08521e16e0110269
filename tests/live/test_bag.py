"""`envpred bag`: forecasts, grids, scans and truth of one drive in one recording, and pictures of costmaps."""

import json
import shutil
import zlib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from envpred.build import jobs
from envpred.build.grids import build
from envpred.cli import main
from envpred.drives import one_drive
from envpred.drives.tracklets import Tracklet
from envpred.live.from_store import placed_window
from envpred.live.placed import LEAST
from envpred.mapping.geometry import GridSpec
from envpred.mapping.mapper import MappingParameters
from envpred.pictures.costmaps import costs
from envpred.results.predictions import FORMAT, Predictions, drive_entry, window_entry
from envpred.simulate import tracklets
from envpred.store import MANIFEST, Store
from tests.drives.synthetic import write_drive
from tests.live.recordings import messages_in, seconds
from tests.remedies import refusal, remedy

DRIVE = "2011_09_26_drive_0001_sync"
CELLS, CONTEXT, HORIZONS = 64, 80, 3


class Folders(NamedTuple):
    source: Path
    store: Path
    predictions: Path


def predict(folder: Path, store: Path, forecast: NDArray[np.float32], role: str = "rollout") -> Path:
    """A folder of forecasts, all the same, after every frame of the drive from the fourth on."""
    drive = Store(store).drives[DRIVE]
    windows = []
    for start in range(len(drive.frames) - 3):
        entry = window_entry(drive, start, 4, HORIZONS)
        file = f"{DRIVE}/{entry['frames'][-1]:010d}.npy"
        (folder / DRIVE).mkdir(parents=True, exist_ok=True)
        np.save(folder / file, forecast)
        windows.append({"file": file, "checksum": zlib.crc32(forecast.tobytes()), **entry})
    manifest = {
        "format": FORMAT,
        "model": {"name": "mine"},
        "role": role,
        "variant": "dst_static",
        "data": {"context": CONTEXT},
        "horizon_s": [0.1, 0.2, 0.3],
        "drives": {DRIVE: drive_entry(drive)},
        "windows": windows,
    }
    (folder / MANIFEST).write_text(json.dumps(manifest))
    return folder


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Folders:
    root = tmp_path_factory.mktemp("bag")
    folder = write_drive(root / "drives", frames=8, speed=20 / 3, azimuths=120)
    car = Tracklet("Car", (4.0, 2.0, 1.5), 2, [(10.0, 1.0, -1.7, 0.0)] * 3, [0] * 3)
    tracklets.write(folder / "tracklet_labels.xml", [car])
    points = one_drive(root / "drives").scan(1)
    (folder / "labels").mkdir()
    np.full(len(points), 252 | 3 << 16, np.uint32).tofile(folder / "labels" / "0000000001.label")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            jobs, "in_processes", lambda job, drives, _: ((len(d.frames), job(d, lambda: None)) for d in drives)
        )
        build(root / "drives", root / "grids", MappingParameters(GridSpec(cells=CELLS)), context=CONTEXT)
    forecast = np.full((HORIZONS, CELLS, CELLS), 0.25, np.float32)
    return Folders(root / "drives", root / "grids", predict(root / "forecasts", root / "grids", forecast))


def bag(out: Path, capsys: pytest.CaptureFixture[str] | None = None, **given: object) -> str:
    main(["bag", f"--out={out}", *(f"--{name}={value}" for name, value in given.items())])
    return capsys.readouterr().out if capsys else ""


def test_a_recording_of_everything(folders: Folders, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "drive.mcap"
    said = bag(out, capsys, predictions=folders.predictions, store=folders.store, source=folders.source)
    assert said == f"{out}: 8 frames of {DRIVE}, 8 scans, 1 boxes, 5 forecasts\n"
    found = messages_in(out)
    counts = {topic: len(messages) for topic, messages in found.items()}
    frames = dict.fromkeys(("/tf", "/odometry", "/points", "/truth/boxes", "/grid"), 8)
    forecasts = dict.fromkeys(
        [f"/forecast/{name}" for name in ("in_0100_ms", "in_0200_ms", "in_0300_ms", "maximum")], 5
    )
    assert counts == frames | forecasts | {"/tf_static": 1}
    drive = Store(folders.store).drives[DRIVE]
    times = np.array(drive.array("time"))
    for topic in frames:
        np.testing.assert_allclose([message.time for message in found[topic]], times, atol=1e-6)
    assert [len(message.content.markers) - 1 for message in found["/truth/boxes"]] == [0, 0, 1, 1, 1, 0, 0, 0]
    assert [message.content.point_step for message in found["/points"]] == [16, 20, *[16] * 6]
    scan = one_drive(folders.source).scan(3)
    np.testing.assert_array_equal(np.frombuffer(found["/points"][3].content.data, "<f4").reshape(-1, 4), scan)
    (static,) = found["/tf_static"][0].content.transforms
    assert static.transform.translation.x == pytest.approx(0.81)


def test_forecasts_lie_where_the_ego_will_be_and_are_stamped_then(folders: Folders, tmp_path: Path) -> None:
    """It drives east, two cells a horizon."""
    bag(tmp_path / "drive.mcap", predictions=folders.predictions, store=folders.store)
    found = messages_in(tmp_path / "drive.mcap")
    assert "/points" not in found
    drive = Store(folders.store).drives[DRIVE]
    now = drive.array("pose")[3, :2, 3]
    for n in (1, 2, 3):
        message = found[f"/forecast/in_0{n}00_ms"][0]
        assert message.time == pytest.approx(0.3)
        assert seconds(message.content.header.stamp) == pytest.approx(0.3 + n / 10)
        assert seconds(message.content.info.map_load_time) == pytest.approx(0.3)
        cell = drive.grid.cell_of(now + np.array([2 * n / 3, 0]), drive.origin)
        corner = drive.origin + (cell - CELLS // 2 - 0.5) / 3
        place = message.content.info.origin.position
        np.testing.assert_allclose([place.x, place.y], corner, atol=1e-6)
        assert 25 in message.content.data
    largest = found["/forecast/maximum"][0].content
    assert largest.info.width > CELLS
    assert max(largest.data) >= 25


def test_the_map_of_a_frame_is_its_evidence(folders: Folders, tmp_path: Path) -> None:
    bag(tmp_path / "drive.mcap", store=folders.store)
    found = messages_in(tmp_path / "drive.mcap")
    assert set(found) == {"/tf", "/tf_static", "/odometry", "/grid"}
    grid = found["/grid"][5].content
    drive = Store(folders.store).drives[DRIVE]
    mass = np.array(drive.array("context_evidence")[5], np.float32)
    rows = np.array(grid.data).reshape(CONTEXT, CONTEXT)
    rim = (CONTEXT - CELLS) // 2
    mass[:, rim:-rim, rim:-rim] = drive.array("evidence")[5]
    assert (rows == -1).any()
    np.testing.assert_array_equal(rows.T == -1, mass.sum(axis=0) < LEAST)
    known = placed_window(Predictions(folders.predictions), 2, Store(folders.store)).known
    np.testing.assert_array_equal(known, rows.T >= 0)  # forecasts know of the same cells
    np.testing.assert_allclose(rows.T[rows.T >= 0], (50 * (mass[0] + 1 - mass[1]))[rows.T >= 0], atol=0.51)


def test_drives_alone_and_chosen_horizons(folders: Folders, tmp_path: Path) -> None:
    bag(tmp_path / "drive.mcap", source=folders.source)
    assert set(messages_in(tmp_path / "drive.mcap")) == {"/tf", "/tf_static", "/odometry", "/points", "/truth/boxes"}
    bag(tmp_path / "some.mcap", predictions=folders.predictions, store=folders.store, horizons="[0.2]")
    topics = {topic for topic in messages_in(tmp_path / "some.mcap") if topic.startswith("/forecast")}
    assert topics == {"/forecast/in_0200_ms", "/forecast/maximum"}


def test_what_moves_on_straight_is_placed_straight_on(folders: Folders, tmp_path: Path) -> None:
    forecast = np.full((HORIZONS, CELLS, CELLS), 0.25, np.float32)
    moved = Predictions(predict(tmp_path / "moved", folders.store, forecast, "moved"))
    store = Store(folders.store)
    rolled = placed_window(Predictions(folders.predictions), 0, store)
    np.testing.assert_allclose(placed_window(moved, 0, store).ego[:, 0] - rolled.now[0], [2, 4, 6], atol=0.1)


def test_a_picture_of_what_a_costmap_makes_of_it(
    folders: Folders, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given: dict[str, Any] = {"predictions": folders.predictions, "store": folders.store}
    assert bag(tmp_path / "costs.png", capsys, **given, window=2) == f"{tmp_path / 'costs.png'}\n"
    assert (tmp_path / "costs.png").read_bytes().startswith(b"\x89PNG")
    bag(tmp_path / "two.png", **given, horizons="[0.1, 0.3]")
    assert (tmp_path / "two.png").stat().st_size != (tmp_path / "costs.png").stat().st_size


def test_costs_are_those_of_the_static_layer() -> None:
    """cost = floor(254 percent / threshold), lethal from the threshold on; with trinary all below is free."""
    rows = np.array([[-1, 0, 25, 50, 99, 100]], np.int8)
    assert costs(rows, trinary=False).tolist() == [[255, 0, 63, 127, 251, 254]]
    assert costs(rows, trinary=True).tolist() == [[255, 0, 0, 0, 0, 254]]
    assert costs(rows, trinary=False, lethal_threshold=50).tolist() == [[255, 0, 127, 254, 254, 254]]


@pytest.mark.parametrize(
    ("args", "line"),
    [
        (["--out=x.bag", "--source={source}"], "x.bag: end its name on .mcap for a recording, or on .png, .pdf or"),
        (
            ["--out=x.mcap"],
            "give what to write: --predictions and their --store, or --store, or drives as --source",
        ),
        (
            ["--out=x.mcap", "--predictions={predictions}"],
            "forecasts: give the grids that were forecast from as --store",
        ),
        (["--out=x.mcap", "--store={store}", "--drive=b"], f"grids: holds no drive b; it has {DRIVE}"),
        (["--out=x.mcap", "--source={source}", "--drive=b"], f"drives: holds no drive b; it has {DRIVE}"),
        (["--out=x.png", "--store={store}"], "a picture shows a forecast; give --predictions and their --store"),
        (["--out=x.png", "--predictions={predictions}", "--store={store}", "--window=5"], "--window 5: there are 5 of"),
        (
            ["--out=x.mcap", "--predictions={predictions}", "--store={store}", "--horizons=[0.4]"],
            "--horizons 0.4: give",
        ),
        (["--out=x.mcap", "--predictions={source}", "--store={store}"], "holds no predictions"),
    ],
)
def test_mistakes_are_one_line(
    folders: Folders, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, args: list[str], line: str
) -> None:
    monkeypatch.chdir(tmp_path)
    said = refusal(["bag", *(arg.format(**folders._asdict()) for arg in args)])
    assert line in said
    assert "\n" not in said
    assert list(tmp_path.iterdir()) == []


def test_what_is_named_completes_the_command(folders: Folders, tmp_path: Path) -> None:
    values = {f"--{name}": value for name, value in folders._asdict().items()}
    out = f"--out={tmp_path / 'x.mcap'}"
    for args in ([], [f"--predictions={folders.predictions}"]):
        options = [option for (option,) in remedy(refusal(["bag", out, *args]))]
        main(["bag", out, *args, *(f"{option}={values[option]}" for option in dict.fromkeys(options))])
    picture = ["bag", f"--out={tmp_path / 'x.png'}", f"--store={folders.store}"]
    options = [option for (option,) in remedy(refusal(picture))]
    main([*picture[:2], *(f"{option}={values[option]}" for option in options)])


def test_an_oracles_forecasts_and_empty_ones_are_refused(folders: Folders, tmp_path: Path) -> None:
    forecast = np.zeros((HORIZONS, CELLS, CELLS), np.float32)
    oracle = predict(tmp_path / "oracle", folders.store, forecast, "oracle")
    args = ["bag", "--out=x.mcap", f"--store={folders.store}"]
    assert "reads the future" in refusal([*args, f"--predictions={oracle}"])
    manifest = json.loads((oracle / MANIFEST).read_text()) | {"windows": [], "role": "learned"}
    (oracle / MANIFEST).write_text(json.dumps(manifest))
    assert f"{oracle}: holds no drive ; it has none" in refusal([*args, f"--predictions={oracle}"])


def test_another_recording_than_was_mapped_is_refused(folders: Folders, tmp_path: Path) -> None:
    write_drive(tmp_path / "drives", frames=8, speed=6.0, azimuths=30)
    args = ["bag", "--out=x.mcap", f"--store={folders.store}"]
    said = refusal([*args, f"--source={tmp_path / 'drives'}"])
    assert "was mapped from other frames or poses than the drive in --source has" in said


def test_damaged_truth_is_one_line(folders: Folders, tmp_path: Path) -> None:
    shutil.copytree(folders.source, tmp_path / "drives")
    drive = next((tmp_path / "drives").glob(f"*/{DRIVE}"))
    args = ["bag", f"--out={tmp_path / 'x.mcap'}", f"--source={tmp_path / 'drives'}"]
    labels = drive / "labels" / "0000000001.label"
    labels.write_bytes(labels.read_bytes()[:-4])
    assert "0000000001.label: has" in refusal(args)
    labels.unlink()
    boxes = drive / "tracklet_labels.xml"
    boxes.write_text(boxes.read_text()[:-20])
    assert "tracklet_labels.xml: " in refusal(args)
    assert not (tmp_path / "x.mcap").exists()
