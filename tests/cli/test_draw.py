"""One window of several methods as a strip or an animation, from folders on the disk."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from envpred.callbacks.predictions import PredictionWriter
from envpred.cli import main
from envpred.cli.draw import draw
from envpred.errors import UserError
from envpred.models import LastFrame, MovedLastFrame
from envpred.models.forecaster import Forecaster
from envpred.results.result import RESULT
from tests.drives.synthetic import write_drive
from tests.models.trainers import grids, trainer
from tests.remedies import refusal, remedy
from tests.report.conftest import record
from tests.results.predictions import FORECAST, folder_of
from tests.store.stores import write_store

DRIVE = "2011_09_26_drive_0001_sync"
Folders = dict[str, Path]


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_store(tmp_path_factory.mktemp("drawn") / "grids", {DRIVE: list(range(20))}, cells=32)


@pytest.fixture(scope="module")
def folders(store: Path, tmp_path_factory: pytest.TempPathFactory) -> Folders:
    """Predictions of two methods over all windows, of one over the newest, eight frames ahead."""
    root = tmp_path_factory.mktemp("predictions")
    asked: list[tuple[str, Forecaster, str, int]] = [
        ("static", LastFrame(given=3), "all", 8),
        ("moved", MovedLastFrame(given=3, fill=0.5), "all", 8),
        ("newest", MovedLastFrame(given=3, fill=0.5), "newest", 23),
    ]
    for name, model, which, length in asked:
        run = trainer(root / f"run_{name}", callbacks=[PredictionWriter(root / name)])
        data = grids(store, test=[DRIVE], predict=which, length=length)
        run.predict(model, datamodule=data, return_predictions=False)
    return {name: root / name for name, _, _, _ in asked}


def colours(file: Path) -> set[tuple[int, ...]]:
    with Image.open(file) as picture:
        return {colour for _, colour in picture.convert("RGB").getcolors(1 << 24) or []}  # type: ignore[misc]


def test_a_strip_of_two_methods_with_targets(folders: Folders, store: Path, tmp_path: Path) -> None:
    out = tmp_path / "pictures" / "strip.png"
    line = draw([folders["static"], folders["moved"]], out, 3, store)
    assert line == f"{out}: {DRIVE}, frame 5"
    with_targets = Image.open(out).size
    assert (86, 180, 233) in colours(out)  # the ego is circled
    draw([folders["static"], folders["moved"]], out, 3, store, circles=False)
    assert (86, 180, 233) not in colours(out)
    draw([folders["static"], folders["moved"]], out, 3)
    without = Image.open(out).size
    assert without[0] == with_targets[0]  # whatever the columns
    assert without[1] != with_targets[1]  # one row and one column less: no targets, and nothing that was seen
    draw([folders["static"]], out, 3, horizons=[0.2, 0.4])
    assert Image.open(out).size[0] == without[0]  # two columns, as before: 0.1 s and 0.5 s
    assert Image.open(out).size[1] < without[1]


def test_animations_play_what_was_seen_and_then_the_forecasts(folders: Folders, store: Path, tmp_path: Path) -> None:
    for folder, window, given, frames in (("static", 3, store, 8), ("newest", 0, store, 23), ("newest", 0, None, 20)):
        draw([folders[folder]], tmp_path / "window.gif", window, given)
        with Image.open(tmp_path / "window.gif") as moving:
            assert moving.n_frames == frames  # type: ignore[attr-defined]


def test_windows_are_found_by_drive_and_frame(folders: Folders, store: Path, tmp_path: Path) -> None:
    """The newest window is the last of all."""
    out = tmp_path / "strip.pdf"
    assert draw([folders["newest"], folders["moved"]], out, 0, store).endswith("frame 19")
    with pytest.raises(
        UserError, match=rf"newest: has no forecast of {DRIVE} after frame 2, .*static has as its window 0"
    ):
        draw([folders["static"], folders["newest"]], out, 0)


def test_pictures_of_the_camera(folders: Folders, store: Path, tmp_path: Path) -> None:
    source = write_drive(tmp_path / "kitti", frames=20).parents[1]
    out = tmp_path / "strip.png"
    draw([folders["static"]], out, 3, store, source)
    plain = Image.open(out).size
    images = source / "2011_09_26" / DRIVE / "image_02" / "data"
    images.mkdir(parents=True, exist_ok=True)
    for frame in (5, 6, 10):  # the last frame shown, 0.1 s and 0.5 s later
        Image.fromarray(np.full((30, 90, 3), (10, 200, 30), np.uint8)).save(images / f"{frame:010d}.png")
    draw([folders["static"]], out, 3, store, source)
    assert Image.open(out).size[1] > plain[1]
    assert (10, 200, 30) in colours(out)
    with pytest.raises(UserError, match="no drive named"):
        draw([folders["static"]], out, 3, store, write_drive(tmp_path / "other", "0007", frames=20).parents[1])


def test_mistakes_get_one_line(folders: Folders, store: Path, tmp_path: Path) -> None:
    static, out = folders["static"], tmp_path / "strip.png"
    mistakes: list[tuple[str, Callable[[], str]]] = [
        (r"--window 18: .*static has 18 windows", lambda: draw([static], out, 18)),
        (r"--window -1", lambda: draw([static], out, -1)),
        (r"--horizons 0\.25: give multiples of 0\.1 s up to 0\.5 s", lambda: draw([static], out, 0, horizons=[0.25])),
        (r"--horizons 0\.6", lambda: draw([static], out, 0, horizons=[0.6])),
        (r"strip\.doc: no picture", lambda: draw([static], tmp_path / "strip.doc")),
        (r"no forecasts there; name what `envpred predict` wrote", lambda: draw([tmp_path], out)),
        (r"nowhere: no such file or folder", lambda: draw([static, tmp_path / "nowhere"], out)),
    ]
    for line, call in mistakes:
        with pytest.raises(UserError, match=line):
            call()
    assert not out.exists()


def test_folders_without_forecasts_are_left_out(
    folders: Folders, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    trained = tmp_path / "trained"
    trained.mkdir()
    undrawn = tmp_path / "undrawn"
    undrawn.mkdir()
    (undrawn / RESULT).write_text(json.dumps(record(LastFrame, "dst_static", 0.1)))
    alone, beside = tmp_path / "alone.png", tmp_path / "beside.png"
    draw([folders["static"]], alone)
    capsys.readouterr()
    draw([trained, folders["static"], undrawn], beside)
    assert capsys.readouterr().err == f"skipped 2 folders without forecasts: {trained}, {undrawn}\n"
    assert beside.read_bytes() == alone.read_bytes()
    with pytest.raises(UserError, match=f"{trained}, {undrawn}: no forecasts there"):
        draw([trained, undrawn], beside)


def test_an_empty_folder_names_what_fills_it(store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("empty").mkdir()
    for (command,) in remedy(refusal(["draw", "empty", "--out=strip.png"])):
        main([command, "--model=LastFrame", f"--data.store={store}", f"--data.test=[{DRIVE}]"])
        folder = max(Path("runs").rglob("version_*"), key=lambda run: run.stat().st_mtime)
        main(["draw", str(folder), f"--out={command}.png"])
        assert Path(f"{command}.png").is_file()


def test_horizons_are_multiples_of_the_predictions_own_period(tmp_path: Path) -> None:
    folder_of(tmp_path / "fast", FORECAST)
    out = tmp_path / "strip.png"
    draw([tmp_path / "fast"], out, horizons=[0.05, 0.15])
    assert out.is_file()
    with pytest.raises(UserError, match=r"--horizons 0\.2: give multiples of 0\.05 s up to 0\.15 s"):
        draw([tmp_path / "fast"], out, horizons=[0.2])


def test_the_command(folders: Folders, store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "strip.png"
    names = [str(folders[name]) for name in ("static", "moved")]
    main(["draw", *names, "--window", "2", "--store", str(store), "--horizons", "[0.1, 0.3]", "--out", str(out)])
    assert capsys.readouterr().out.strip() == f"{out}: {DRIVE}, frame 4"
    assert out.stat().st_size > 10_000
