"""A stream forecasts what the batch path does, places it in the world and in time, and lasts."""

import resource
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from lightning.pytorch import seed_everything

import envpred
from envpred.build.dogma import build_dogma
from envpred.build.grids import build
from envpred.datamodules import GridDataModule
from envpred.drives import Drive
from envpred.errors import UserError
from envpred.live.ahead import UNKNOWN, LiveForecast, _between
from envpred.live.stream import Stream
from envpred.mapping.dogma import DogmaParameters
from envpred.mapping.geometry import GridSpec
from envpred.mapping.mapper import MappingParameters
from envpred.mapping.particle_state import GROUND
from envpred.models import Forecaster, LastFrame, PredNetForecaster, RolloutForecaster, RolloutOracle
from tests.live.replays import forecast_frames
from tests.live.streams import GRID, feed, ready

PARTICLES = DogmaParameters(replace(GROUND, persistent=2000, births=200))


@pytest.fixture(scope="module")
def store(drive: Drive, tmp_path_factory: pytest.TempPathFactory) -> Path:
    source, folder = drive.folder.parents[1], tmp_path_factory.mktemp("stores") / "grids"  # type: ignore[attr-defined]
    build(source, folder, MappingParameters(GRID), workers=1, context=64)
    build_dogma(folder, PARTICLES, workers=1)
    return folder


def prednet() -> Forecaster:
    seed_everything(3, verbose=False)
    return PredNetForecaster(channels=[4], variant="dst_dogma")


FORECASTERS: dict[str, Callable[[], Forecaster]] = {
    "last_frame": LastFrame,
    "rollout": lambda: RolloutForecaster(movers=True, samples=True, futures=4),
    "prednet": prednet,
}


def batch_forecasts(store: Path, forecaster: Forecaster) -> Iterator[tuple[int, Any]]:
    """Forecasts after every frame of the store by the data module: the position of the last frame shown, and it."""
    data = GridDataModule(store, variant=forecaster.variant, predict="all")
    trainer: Any = SimpleNamespace(lightning_module=forecaster, current_epoch=0)
    data.trainer = trainer
    data.setup("predict")
    forecaster.eval()
    for batch in data.predict_dataloader():
        with torch.inference_mode():
            yield int(batch["start"][0]) + data.given - 1, forecaster.forecast(batch["seen"], data.horizons)


@pytest.mark.parametrize("name", FORECASTERS)
def test_a_stream_equals_the_batch_path_to_the_bit(name: str, drive: Drive, store: Path) -> None:
    forecaster = FORECASTERS[name]()
    expected = dict(batch_forecasts(store, forecaster))
    said: list[str] = []
    stream = Stream.of(forecaster, drive, grid=GRID, context=64, velocities=PARTICLES, warn=said.append)
    found = {
        t: forecast
        for t, k in enumerate(drive.frames)
        if (forecast := stream.update(drive.scan(k), drive.pose(k), drive.time(k))) is not None
    }
    assert list(found) == list(expected) == forecast_frames()
    for t, forecast in found.items():
        np.testing.assert_array_equal(forecast.probability, expected[t].probability[0].numpy())
        if expected[t].samples is not None:
            np.testing.assert_array_equal(forecast.samples, expected[t].samples[0].numpy())
    assert said == ["no scan for 0.20 s before 1.90 s: evidence starts anew"]


def test_the_grids_of_a_forecast_have_a_place_and_a_time(drive: Drive) -> None:
    """The car drives east at 5 m/s: grids move with it, and the last frame's lies around it."""
    stream, _ = ready(drive)
    forecast = stream.update(drive.scan(10), drive.pose(10), drive.time(10))
    assert isinstance(forecast, LiveForecast)
    assert forecast.stamp == pytest.approx(1.0 + 0.1 * np.arange(1, 16))
    middle = forecast.origin + forecast.resolution * GRID.cells / 2
    ego = np.stack([drive.pose(k)[:2, 3] for k in range(11, 18)])
    assert np.abs(middle[:7] - ego).max() < 2 * forecast.resolution
    assert forecast.probability.shape == (15, 32, 32)
    late = stream.update(drive.scan(11), drive.pose(11), drive.time(11), delay=0.25)
    assert late is not None
    assert late.delay == 0.25
    assert late.stamp == pytest.approx(1.1 + 0.25 + 0.1 * np.arange(1, 16))


def test_exports_take_the_last_forecast(drive: Drive) -> None:
    """With the samples' own egos, and none before there is a forecast or after evidence has started anew."""
    stream = Stream.of(RolloutForecaster(samples=True, futures=2), drive, grid=GRID, warn=lambda said: None)
    assert stream.placed() is None
    feed(stream, drive, range(6))
    found = stream.placed()
    assert found is not None
    assert stream.forecast is not None
    np.testing.assert_array_equal(found.probability, stream.forecast.probability[0])
    assert found.sample_ego is not None
    assert found.sample_ego.shape == (2, 15, 3)
    assert found.time == drive.time(5)
    origin, resolution = np.array(found.origin), found.resolution
    assert found.now[:2] * resolution + origin == pytest.approx(drive.pose(5)[:2, 3], abs=1e-4)
    feed(stream, drive, range(9, 10))
    assert stream.placed() is None


def test_a_delay_forecasts_from_a_later_present(drive: Drive) -> None:
    """By whole horizons the same grids later; between two of them, their weighted mean, moved to where the ego is."""
    forecasts: dict[float, LiveForecast] = {}
    for delay, horizons in ((0.0, 17), (0.1, 15), (0.03, 15), (0.2, 15)):
        stream = Stream.of(RolloutForecaster(futures=4), drive, grid=GRID, horizons=horizons, delay=delay)
        for t in range(11):
            if (found := stream.update(drive.scan(t), drive.pose(t), drive.time(t))) is not None:
                forecasts[delay] = found
    plain, later, soon, last = (forecasts[delay] for delay in (0.0, 0.1, 0.03, 0.2))
    np.testing.assert_array_equal(later.probability, plain.probability[1:16])
    np.testing.assert_array_equal(last.probability, plain.probability[2:17])
    np.testing.assert_allclose(later.stamp, plain.stamp[1:16])
    np.testing.assert_allclose(soon.stamp, plain.stamp[:15] + 0.03)
    assert (plain.origin[:15] != plain.origin[1:16]).any(axis=1).all()  # the car moves by more than a cell a frame
    for n in range(15):
        shifts = [np.rint((soon.origin[n] - plain.origin[m]) / soon.resolution).astype(int) for m in (n, n + 1)]
        a, b = (plain.probability[n + s][4 + i : 28 + i, 4 + j : 28 + j] for s, (i, j) in enumerate(shifts))
        np.testing.assert_allclose(soon.probability[n][4:-4, 4:-4], 0.7 * a + 0.3 * b, atol=1e-4)


def test_cells_that_no_grid_shows_are_unknown() -> None:
    grids, centres = torch.zeros(2, 4, 4), np.array([[0, 0], [2, 2]])
    found = _between(grids, centres, 0, 1, 0.5, np.array([1, 1]))
    assert found[0, -1] == found[-1, 0] == UNKNOWN
    assert found[:-1, :-1].max() == found[1:, 1:].max() == 0


def test_restarting_loses_no_more_than_the_context(drive: Drive) -> None:
    """A stream that begins later forecasts after as many frames as it shows, and soon knows nearly as much."""
    stream, _ = ready(drive)
    again = Stream.of(LastFrame(), drive, grid=GRID)
    assert feed(again, drive, range(5, 10)) == [False] * 4 + [True]
    a, b = stream.mapped, again.mapped
    assert a is not None
    assert b is not None
    assert np.abs(a.mass - b.mass).max() <= 0.9**5 + 1e-6  # what was seen before has faded to that
    np.testing.assert_array_equal(a.label, b.label)


def resident() -> float:
    """Memory of this process, MiB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


@pytest.mark.slow
def test_ten_thousand_scans_leave_memory_as_it_was(drive: Drive) -> None:
    forecaster = RolloutForecaster(futures=2, samples=True)
    stream = Stream.of(forecaster, drive, grid=GridSpec(16), horizons=3, warn=lambda said: None)
    scans, pose, found = [drive.scan(k) for k in drive.frames[:10]], np.eye(4), []
    for n in range(10_000):
        pose[0, 3] = 0.5 * n
        assert (stream.update(scans[n % 10], pose.copy(), 0.1 * n) is None) == (n < 4)
        if n % 1000 == 999:
            found.append(resident())
    assert max(found[2:]) - found[1] < 8  # what is known after so many scans would take a hundred


def test_what_a_stream_cannot_run_is_refused(drive: Drive) -> None:
    with pytest.raises(UserError, match="RolloutOracle reads the ego's true motion, which a stream does not know"):
        Stream(RolloutOracle())
    trained = LastFrame()
    trained.trained = {"data": {"period": 0.1, "resolution": 1 / 3, "cells": 128}}
    with pytest.raises(UserError, match="trained on grids of 128 cells, this stream has 32 cells; give it grids like"):
        Stream.of(trained, drive, grid=GRID)
    assert Stream.of(trained, drive).mapper.grid == GridSpec(128)  # by default those that it was trained on
    with pytest.raises(UserError, match="--delay -1"):
        Stream(LastFrame(), delay=-1)
    with pytest.raises(UserError, match="--horizons 0"):
        Stream(LastFrame(), horizons=0)


def test_it_belongs_to_the_face() -> None:
    assert envpred.Stream is Stream
