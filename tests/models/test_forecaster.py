import json
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import nn

from envpred.datamodules import Forecast, Seen, WindowBatch
from envpred.errors import UserError
from envpred.mapping.evidence import pignistic
from envpred.mapping.geometry import FREE, OCCUPIED
from envpred.models import LastFrame
from envpred.models.forecaster import Forecaster
from envpred.results.result import RESULT, short_name
from envpred.store import Store
from tests.models.trainers import grids, prednet, trainer


def by_hand(store: Path, drive: str) -> NDArray[np.floating]:
    """Static baseline's MSE (windows, horizons) of windows of 8 frames, 3 of them shown."""
    probability = pignistic(np.asarray(Store(store).drives[drive].array("evidence")))
    windows = probability[: len(probability) // 8 * 8].reshape(-1, 8, *probability.shape[1:])
    return np.asarray(((windows[:, 3:] - windows[:, 2:3]) ** 2).mean(axis=(2, 3)))


@pytest.mark.parametrize("batch_size", [1, 2])
@pytest.mark.parametrize("variant", ["dst_static", "prob_static"])
def test_static_baseline_and_its_result(store: Path, tmp_path: Path, batch_size: int, variant: str) -> None:
    """Horizon h is compared with the h-th frame after those shown, in every variant alike."""
    data = grids(store, variant=variant, test=["c"], batch_size=batch_size)
    run = trainer(tmp_path)
    (logged,) = run.test(LastFrame(variant, given=3), datamodule=data, verbose=False)
    expected = by_hand(store, "c")
    result = json.loads((tmp_path / RESULT).read_text())
    mse = result["metrics"]["mse"]
    np.testing.assert_allclose(mse["per_window"], expected, rtol=1e-5)
    np.testing.assert_allclose(mse["mean"], expected.mean(axis=0), rtol=1e-5)
    np.testing.assert_allclose(mse["standard_error"], expected.std(axis=0, ddof=1) / np.sqrt(3), rtol=1e-4)
    np.testing.assert_allclose(result["metrics"]["skill"]["mean"], 0, atol=1e-7)
    assert logged["test/mse_0.1s"] == pytest.approx(expected[:, 0].mean())
    assert result["data"]["windows"] == [["c", 0], ["c", 8], ["c", 16]]
    assert result["data"]["part"] == "test"
    assert result["model"]["name"] == "last_frame"
    assert result["horizon_s"] == [0.1, 0.2, 0.3, 0.4, 0.5]
    assert result["variant"] == variant
    assert result["revision"]


def test_outcomes_are_what_was_measured_in_the_targets_frames(store: Path, tmp_path: Path) -> None:
    """Of all cells that are judged a share of 1 was measured, and by those the scores are."""
    trainer(tmp_path).test(LastFrame(given=3), datamodule=grids(store, test=["c"]), verbose=False)
    metrics = json.loads((tmp_path / RESULT).read_text())["metrics"]
    drive = Store(store).drives["c"]
    label = np.asarray(drive.array("label"))[:24].reshape(3, 8, 16, 16)
    said = pignistic(np.asarray(drive.array("evidence")))[:24].reshape(3, 8, 16, 16)[:, 2:3]
    was = np.isin(label, (OCCUPIED, FREE))[:, 3:]
    assert not was.all()
    assert np.sum(metrics["reliability"]["count"], axis=1).tolist() == was.sum(axis=(0, 2, 3)).tolist()
    squares = np.where(was, (said - (label[:, 3:] == OCCUPIED)) ** 2, 0).sum(axis=(2, 3)) / was.sum(axis=(2, 3))
    np.testing.assert_allclose(metrics["brier"]["per_window"], squares, rtol=1e-5)


def test_skill_of_a_forecaster_is_against_the_static_baseline_of_its_windows(store: Path, tmp_path: Path) -> None:
    run = trainer(tmp_path)
    run.test(prednet(), datamodule=grids(store, test=["b"]), verbose=False)
    metrics = json.loads((tmp_path / RESULT).read_text())["metrics"]
    np.testing.assert_allclose(metrics["static_mse"]["mean"], by_hand(store, "b").mean(axis=0), rtol=1e-5)
    ratio = np.divide(metrics["mse"]["mean"], metrics["static_mse"]["mean"])
    np.testing.assert_allclose(metrics["skill"]["mean"], 1 - ratio, rtol=1e-6)


def test_validation_logs_the_paper_horizons_and_the_reference(store: Path, tmp_path: Path) -> None:
    (logged,) = trainer(tmp_path).validate(LastFrame(given=3), datamodule=grids(store, val=["a"]), verbose=False)
    expected = by_hand(store, "a").mean(axis=0)
    assert logged["val/mse_0.5s"] == pytest.approx(expected[4], rel=1e-5)
    assert logged["static/mse_0.5s"] == pytest.approx(expected[4], rel=1e-5)
    assert logged["val/mse"] == pytest.approx(expected.mean(), rel=1e-5)
    assert "val/mse_1.0s" not in logged  # windows of 8 frames do not reach that far


def test_predictions_say_where_they_belong(store: Path, tmp_path: Path) -> None:
    out = trainer(tmp_path).predict(prednet(), datamodule=grids(store, test=["b", "c"]))
    assert out is not None
    assert [(p["drive"], p["start"].tolist()) for p in out][3:] == [(["c"], [0]), (["c"], [8]), (["c"], [16])]  # type: ignore[call-overload]
    assert out[0]["forecast"].shape == (1, 5, 16, 16)  # type: ignore[call-overload]


class OneConvolution(Forecaster):
    """A kernel of 3 x 3 over the last frame, for each horizon alike."""

    def __init__(self) -> None:
        super().__init__("dst_static", given=3)
        self.kernel = nn.Conv2d(2, 1, 3, padding=1)

    def forecast(self, seen: Seen, horizons: int) -> Forecast:
        return Forecast(torch.cat([self.kernel(seen["frames"][:, -1]) for _ in range(horizons)], 1))


def test_a_forecast_of_other_horizons_is_refused(store: Path, tmp_path: Path) -> None:
    class Short(LastFrame):
        def forecast(self, seen: Seen, horizons: int) -> Forecast:
            return super().forecast(seen, horizons - 1)

    with pytest.raises(UserError, match=r"Short forecast \(1, 4, 16, 16\) where .* = \(1, 5, 16, 16\) was asked for"):
        trainer(tmp_path).predict(Short(given=3), datamodule=grids(store, test=["b"]))


def test_samples_of_other_forecasts_are_refused(store: Path, tmp_path: Path) -> None:
    class Drawing(LastFrame):
        """Draws as many samples as there are horizons, in the wrong order of axes."""

        def forecast(self, seen: Seen, horizons: int) -> Forecast:
            forecast = super().forecast(seen, horizons).probability
            return Forecast(forecast, samples=forecast[:, :, None].expand(-1, -1, 7, -1, -1))

    with pytest.raises(UserError, match=r"Drawing drew samples \(1, 5, 7, 16, 16\), not \(1, 'K', 5"):
        trainer(tmp_path).test(Drawing(given=3), datamodule=grids(store, test=["c"]), verbose=False)


def test_work_is_counted(store: Path, tmp_path: Path) -> None:
    """Five forecasts of 16 x 16 cells, each of 9 x 2 multiply-adds; a baseline without weights has no such number."""
    for model, work in ((OneConvolution(), 2 * 5 * 16 * 16 * 9 * 2), (LastFrame(given=3), None)):
        trainer(tmp_path).test(model, datamodule=grids(store, test=["c"]), verbose=False)
        assert json.loads((tmp_path / RESULT).read_text())["model"]["flops"] == work


def test_short_names() -> None:
    names = ("PredNetForecaster", "LastFrame", "FCNForecaster", "CorrectedRolloutForecaster")
    assert [short_name(name) for name in names] == ["prednet", "last_frame", "fcn", "corrected_rollout"]


class OneSecondEach(LastFrame):
    """Takes a second a window, as far as the clock of the test step goes."""

    def test_step(self, batch: WindowBatch, batch_index: int) -> None:
        super().test_step(batch, batch_index)
        self.forecast_seconds = float(self.forecast_windows)


@pytest.mark.slow
def test_two_processes_give_the_result_of_one(store: Path, tmp_path: Path) -> None:
    """Three windows over two processes: the sampler pads with a duplicate, which must not count.

    Each process forecasts half of the windows, in half of the time: a window takes as long as before.
    """
    for name, devices in (("one", 1), ("two", 2)):
        run = trainer(tmp_path / name, devices=devices, strategy="ddp_spawn" if devices > 1 else "auto")
        run.test(OneSecondEach(given=3), datamodule=grids(store, test=["c"]), verbose=False)
    one, two = (json.loads((tmp_path / n / RESULT).read_text()) for n in ("one", "two"))
    assert one["metrics"] == two["metrics"]
    assert one["forecast_seconds_per_window"] == two["forecast_seconds_per_window"] == 1
