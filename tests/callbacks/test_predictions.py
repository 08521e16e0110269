"""What `predict` writes: arrays a window, and a manifest that places them."""

import errno
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from lightning.pytorch import Trainer
from numpy.typing import NDArray

from envpred.callbacks.predictions import PredictionWriter
from envpred.cli import main
from envpred.datamodules import Forecast, Seen
from envpred.errors import UserError
from envpred.mapping.evidence import pignistic
from envpred.models import FCNForecaster, LastFrame, MovedLastFrame, MovedLastFrameOracle, ParticleForecast
from envpred.models.forecaster import Forecaster
from envpred.results.predictions import FORMAT, Predictions
from envpred.store import Store
from tests.models.trainers import grids, prednet, trainer
from tests.remedies import remedy
from tests.store.stores import write_store


@pytest.fixture(scope="module")
def gaps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Drives whose frame numbers do not begin at 0; the last run of the second is shorter than what is shown."""
    frames = {"a": list(range(7, 27)), "b": [*range(3, 15), 20, 21]}
    return write_store(tmp_path_factory.mktemp("gaps") / "grids", frames, dogma=True)


def predict(model: Forecaster, store: Path, out: Path, dtype: Any = "float32", **options: Any) -> Predictions:
    run: Trainer = trainer(out.with_name(f"run_{out.name}"), callbacks=[PredictionWriter(out, dtype)])
    defaults: dict[str, Any] = {"test": ["a", "b"]}
    run.predict(model, datamodule=grids(store, **(defaults | options)), return_predictions=False)
    return Predictions(out)


def probability(store: Path, drive: str) -> NDArray[np.float32]:
    return pignistic(np.array(Store(store).drives[drive].array("evidence"), np.float32))


def windows(found: Predictions) -> list[tuple[str, list[int], int]]:
    return [(w["drive"], w["frames"], w["targets"]) for w in found.windows]


def test_newest_frames_without_targets(gaps: Path, tmp_path: Path) -> None:
    """The last three frames of a run, of which nothing is known that follows; b's last run has two."""
    found = predict(LastFrame(given=3), gaps, tmp_path / "out", predict="newest")
    assert windows(found) == [("a", [24, 25, 26], 0), ("b", [12, 13, 14], 0)]
    np.testing.assert_array_equal(found.forecast(0), np.repeat(probability(gaps, "a")[-1:], 5, axis=0))
    np.testing.assert_array_equal(found.forecast(1), np.repeat(probability(gaps, "b")[11:12], 5, axis=0))
    assert found.manifest["data"]["window_rule"] == "windows of 3 frames shown, newest of each drive"


def test_a_window_after_every_frame(gaps: Path, tmp_path: Path) -> None:
    found = predict(LastFrame(given=3), gaps, tmp_path / "out", predict="all", batch_size=4)
    assert [w["frames"][-1] for w in found.windows] == [*range(9, 27), *range(5, 15)]
    assert [w["targets"] for w in found.windows][:18] == [5] * 13 + [5 - k for k in range(1, 6)]
    assert len(list((tmp_path / "out").rglob("*.npy"))) == 28


def test_the_manifest_places_every_window(gaps: Path, tmp_path: Path) -> None:
    found = predict(LastFrame(given=3), gaps, tmp_path / "out", predict="test")
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert [w["frames"] for w in manifest["windows"]] == [[7, 8, 9], [15, 16, 17], [3, 4, 5]]
    second = manifest["windows"][1]
    assert (second["start"], second["start_frame"], second["targets"]) == (8, 15, 5)
    assert second["file"] == "a/0000000017.npy"
    # The drive's tenth position: see tests.store.stores.
    assert second["centre_cell"] == [40 + 10 // 3, 40]
    assert second["target_centre_cell"] == [[40 + t // 3, 40] for t in range(11, 16)]
    assert second["pose"] == pytest.approx({"east_m": 10 / 9 + 40 / 3, "north_m": 40 / 3, "heading_rad": 0})
    assert manifest["drives"]["a"]["lattice_origin_m"] == [0, 0]
    assert manifest["drives"]["a"]["resolution_m"] == pytest.approx(1 / 3)
    assert manifest["horizon_s"] == [0.1, 0.2, 0.3, 0.4, 0.5]
    assert (manifest["given"], manifest["variant"], manifest["dtype"]) == (3, "dst_static", "float32")
    assert manifest["model"]["name"] == "last_frame"
    assert {"revision", "command", "checkpoint", "seed", "what"} <= set(manifest)
    assert found.label == "Static"


def test_halves_are_close(gaps: Path, tmp_path: Path) -> None:
    exact = predict(prednet(), gaps, tmp_path / "exact", test=["a"])
    half = predict(prednet(), gaps, tmp_path / "half", "float16", test=["a"])
    assert np.load(tmp_path / "half" / half.windows[0]["file"]).dtype == np.float16
    assert 0 < np.abs(exact.forecast(0) - half.forecast(0)).max() < 2.5e-4


def test_horizons_beyond_those_trained_and_beyond_the_drive(gaps: Path, tmp_path: Path) -> None:
    """Forecasts over 40 frames from drives of 20: the first five are those over five."""
    near = predict(prednet(), gaps, tmp_path / "near", predict="newest")
    far = predict(prednet(), gaps, tmp_path / "far", predict="newest", length=43)
    assert far.forecast(0).shape == (40, 16, 16)
    np.testing.assert_allclose(far.forecast(0)[:5], near.forecast(0), atol=1e-6)
    assert far.manifest["horizon_s"][-1] == 4.0
    moved = predict(MovedLastFrame(given=3, fill=0.25), gaps, tmp_path / "moved", predict="newest", length=43)
    assert moved.forecast(0).shape == (40, 16, 16)
    # A third of a cell a frame: after 38 frames the first column has moved by 13 cells.
    assert (moved.forecast(0)[38, 4:] == 0.25).all()


def test_what_cannot_be_forecast_is_refused_with_one_line(gaps: Path, tmp_path: Path) -> None:
    for model, options, line in (
        (MovedLastFrameOracle(given=3), {"predict": "newest"}, r"true motion.*--data\.predict test"),
        (
            ParticleForecast(given=3),
            {"predict": "newest", "length": 19},
            r"reaches 15 frames.*--data\.length 18 or less",
        ),
        (FCNForecaster(given=3, horizons=5, width=0.05), {"length": 9}, r"--data\.length 8 or less"),
        (
            LastFrame(given=21),
            {"predict": "newest", "given": 21, "length": 22},
            r"no window of 21 frames.*smaller --data\.given",
        ),
    ):
        with pytest.raises(UserError, match=line):
            predict(model, gaps, tmp_path / "out", **options)
        assert not (tmp_path / "out").exists()
        assert not list(tmp_path.glob(".part*"))


def test_the_oracle_and_the_particle_forecast_where_they_can(gaps: Path, tmp_path: Path) -> None:
    oracle = predict(MovedLastFrameOracle(given=3, fill=0.5), gaps, tmp_path / "oracle", predict="test")
    assert len(oracle.windows) == 3
    particles = predict(ParticleForecast(given=3), gaps, tmp_path / "particles", predict="newest", length=18)
    stored = Store(gaps).drives["a"].array("particle_forecast")[-1]
    np.testing.assert_allclose(particles.forecast(0), stored.astype(np.float32) / 255, atol=1e-7)


def test_a_folder_that_holds_something_is_left_alone(gaps: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("mine")
    with pytest.raises(UserError, match=r"holds files already.*--predictions\.folder"):
        predict(LastFrame(given=3), gaps, tmp_path / "out")
    assert [file.name for file in (tmp_path / "out").iterdir()] == ["mine.txt"]
    (tmp_path / "empty").mkdir()
    assert len(predict(LastFrame(given=3), gaps, tmp_path / "empty").windows) == 3


def test_a_folder_that_cannot_be_written_is_one_line(
    gaps: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    run = trainer(tmp_path / "run", callbacks=[PredictionWriter(tmp_path / "file" / "out")])
    with pytest.raises(UserError, match=r"file/out: cannot be written \(.+\); give another folder"):
        run.predict(LastFrame(given=3), datamodule=grids(gaps, test=["a"]))

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(np, "save", full)
    with pytest.raises(UserError, match=r"/out: cannot be written \(No space left on device\); make room"):
        predict(LastFrame(given=3), gaps, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_what_fails_half_way_leaves_nothing(gaps: Path, tmp_path: Path) -> None:
    class Fails(LastFrame):
        forecasts = 0

        def forecast(self, seen: Seen, horizons: int) -> Forecast:
            self.forecasts += 1
            if self.forecasts > 2:
                raise RuntimeError("out of memory")
            return super().forecast(seen, horizons)

    with pytest.raises(RuntimeError, match="out of memory"):
        predict(Fails(given=3), gaps, tmp_path / "out")
    assert [file.name for file in tmp_path.iterdir()] == ["run_out"]


def rewrite(file: Path, **changes: Any) -> None:
    file.write_text(json.dumps(json.loads(file.read_text(encoding="utf-8")) | changes), encoding="utf-8")


DAMAGE: dict[str, Callable[[Path], object]] = {
    "0000000009.npy: damaged": lambda out: np.save(out / "a" / "0000000009.npy", np.zeros((4, 16, 16))),
    "0000000009.npy: changed since": lambda out: np.save(out / "a" / "0000000009.npy", np.ones((5, 16, 16), "f4")),
    "0000000017.npy: missing": lambda out: (out / "a" / "0000000017.npy").unlink(),
    f"format 99, this version reads {FORMAT}": lambda out: rewrite(out / "manifest.json", format=99),
    r"manifest\.json is missing": lambda out: (out / "manifest.json").unlink(),
    r"manifest\.json: cannot be read": lambda out: (out / "manifest.json").write_text("{"),
}


@pytest.mark.parametrize("what", DAMAGE)
def test_what_is_damaged_is_deleted_and_predicted_again(
    gaps: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    predict(LastFrame(given=3), gaps, tmp_path / "out")
    DAMAGE[what](tmp_path / "out")
    with pytest.raises(UserError, match=what) as refusal:
        read_all(tmp_path / "out")
    assert str(tmp_path / "out") in str(refusal.value)
    predict_again(gaps, tmp_path / "out", refusal.value, monkeypatch)
    assert read_all(tmp_path / "out") == 3


def read_all(folder: Path) -> int:
    found = Predictions(folder)
    return len([found.forecast(k) for k in range(len(found.windows))])


def predict_again(store: Path, folder: Path, message: object, patch: pytest.MonkeyPatch) -> None:
    """Do what a message says that names `envpred predict`."""
    patch.chdir(folder.parent)
    shutil.rmtree(folder)
    command = remedy(message)[-1]
    data = [f"--data.{name}" for name in (f"store={store}", "test=[a, b]", "length=8", "given=3")]
    main([*command, "--model=LastFrame", *data, f"--predictions.folder={folder}"])


def test_scenes_have_targets_where_there_are_any(gaps: Path, tmp_path: Path) -> None:
    found = predict(LastFrame(given=3), gaps, tmp_path / "out", predict="all", test=["a"])
    store, truth = Store(gaps), probability(gaps, "a")
    inside, almost, last = (found.scene(k, store) for k in (4, 15, 17))
    np.testing.assert_array_equal(inside.seen, truth[4:7])
    np.testing.assert_array_equal(inside.target, truth[7:12])
    assert inside.frames == (11, 12, 13)
    assert (len(almost.target), len(almost.centre_cell)) == (2, 5)
    assert (len(last.target), len(last.seen)) == (0, 3)
    alone = found.scene(4)
    assert (len(alone.seen), len(alone.target)) == (0, 0)


def test_another_store_is_refused(gaps: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = predict(LastFrame(given=3), gaps, tmp_path / "out")
    other = write_store(tmp_path / "other", {name: list(range(7, 27)) for name in "ab"}, seed=5)
    with pytest.raises(UserError, match=f"{other}: does not hold the grids of a that {tmp_path / 'out'}") as refusal:
        found.scene(0, Store(other))
    args = ["draw", str(tmp_path / "out"), f"--out={tmp_path / 'strip.png'}"]
    (option, *_) = remedy(refusal.value)
    main([*args, *option, str(gaps)])
    predict_again(other, tmp_path / "out", refusal.value, monkeypatch)
    assert Predictions(tmp_path / "out").scene(0, Store(other)).drive == "a"


@pytest.mark.slow
def test_two_processes_write_what_one_does(gaps: Path, tmp_path: Path) -> None:
    for name, devices in (("one", 1), ("two", 2)):
        run = trainer(
            tmp_path / f"run_{name}",
            devices=devices,
            strategy="ddp_spawn" if devices > 1 else "auto",
            callbacks=[PredictionWriter(tmp_path / name)],
        )
        data = grids(gaps, test=["a", "b"], predict="all")
        run.predict(LastFrame(given=3), datamodule=data, return_predictions=False)
    one, two = (Predictions(tmp_path / name) for name in ("one", "two"))
    assert one.windows == two.windows
    assert all(torch.equal(torch.from_numpy(one.forecast(k)), torch.from_numpy(two.forecast(k))) for k in range(28))
