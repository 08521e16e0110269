"""Where forecasts lie, and what is left of the ego that they were made for."""

from typing import cast

import numpy as np
import pytest
import torch

from envpred.datamodules import Forecast, Seen
from envpred.errors import UserError
from envpred.live.placed import TRAIL, PlacedForecast
from envpred.live.risk import risk
from envpred.mapping.geometry import FREE, UNKNOWN, GridSpec
from envpred.mapping.mapper import Mapper, MappingParameters
from envpred.models import RolloutForecaster
from tests.drives.synthetic import motion, scans
from tests.live.forecasts import HOME, cell, empty, standing


def test_the_forecasts_own_ego_is_no_obstacle() -> None:
    """It drives east by 2 m a second; its cells are taken from before it came, and so is the trail that it leaves.

    Cells of a metre are the ego's within 2 m of a body of 2 m by 1 m, by the mapping's margin and by one for its egos.
    """
    ego = HOME + np.array([[2.0, 0, 0], [4, 0, 0], [6, 0, 0]])
    grids = np.full((3, 16, 16), 0.8, np.float32)
    present = np.full((48, 48), 0.3, np.float32)
    told = standing(grids, ego=ego, present=present, period=TRAIL / 2).told()
    assert told[0, 8, 8] == pytest.approx(0.0)  # x = 22 was under the ego at the present
    assert told[0, 8 + 2, 8] == pytest.approx(0.3)  # x = 24: not yet
    assert told[0, 8 + 4, 8] == pytest.approx(0.8)  # x = 26, out of the way
    assert told[0, 8, 8 + 5] == pytest.approx(0.8)
    assert told[2, 8 + 2, 8] == pytest.approx(0.8)  # x = 28: what was told of it before
    assert told[2, 8 - 7, 8] == pytest.approx(0.0)  # x = 19: left half a second ago
    longer = standing(grids, ego=ego, present=present, period=TRAIL).told()
    assert longer[2, 8 - 7, 8] == pytest.approx(0.8)  # and more than that


def test_the_egos_cells_lie_where_its_sensor_does() -> None:
    """Heading 4 east, 3 north: 5 m behind the pose and 5 m to its left are (-4 - 3, -3 + 4) m from it."""
    pose = HOME + np.array([0, 0, np.arctan2(3, 4)])
    present = np.full((48, 48), 0.3, np.float32)
    grids = np.full((1, 16, 16), 0.8, np.float32)
    (told,) = standing(grids, ego=pose[None], now=pose, present=present, sensor=(-5.0, 5.0, 0.0)).told()
    assert told[cell(20 - 7, 15 + 1)] == 0
    assert told[cell(20, 15)] == told[cell(20 - 7, 15 - 7)] == told[cell(20 - 1, 15 + 1)] == pytest.approx(0.8)


def test_what_lies_beyond_what_is_known_is_not_told() -> None:
    forecast = standing(empty(2), ego=np.tile(HOME + np.array([20, 0, 0]), (2, 1)))
    told = forecast.told()
    assert np.isfinite(told[:, :11]).all()  # the present ends 23 m east of its ego
    assert np.isnan(told[:, 12:]).all()
    known = np.ones((48, 48), np.bool_)
    known[30, 29] = False  # x = 26, y = 20
    (told,) = standing(empty(1), known=known).told()
    assert np.isnan(told[cell(26)])
    assert np.count_nonzero(np.isnan(told)) == 1


def test_grids_and_egos_must_belong_together() -> None:
    with pytest.raises(ValueError, match="do not belong together"):
        standing(empty(3), ego=np.tile(HOME, (2, 1)))
    with pytest.raises(ValueError, match="do not belong together"):
        standing(empty(3), samples=empty(3)[None])


@pytest.fixture(scope="module")
def street() -> tuple[RolloutForecaster, Seen, Mapper]:
    """A street to the east: five frames at 6.7 m/s, between houses and parked cars 5 to 14 m to either side."""
    poses = motion(5, speed=20 / 3)
    forecaster = RolloutForecaster(futures=4, context=False, samples=True).eval()
    mapper = Mapper(MappingParameters(GridSpec(64)))
    mapped = [
        mapper.step(points, pose, t / 10) for t, (points, pose) in enumerate(zip(scans(poses), poses, strict=True))
    ]
    return forecaster, forecaster.see(mapper, mapped), mapper


def test_a_forecast_of_scans_is_placed_with_its_samples(street: tuple[RolloutForecaster, Seen, Mapper]) -> None:
    forecaster, seen, mapper = street
    assert mapper.origin is not None
    forecast = forecaster.forecast(seen, 10)
    futures = forecaster.futures(seen, 10)[0].numpy()
    placed = PlacedForecast.of(forecast, seen, mapper.origin, 0.4, futures)
    steps = np.diff(np.concatenate([placed.now[None], placed.ego])[:, 0])
    np.testing.assert_allclose(steps, 2, atol=0.2)
    assert len(list(placed.sampled())) == 4
    x, y, heading = *(placed.now[:2] / 3 + mapper.origin), placed.now[2]
    ahead = np.array([[x, y, heading, 0], [x + 20 / 3, y, heading, 1]])
    aside = np.array([[x, y, heading, 0], [x + 20 / 3, y - 8, heading - 0.9, 1]])  # into what stands on the right
    straight, into = risk(ahead, placed), risk(aside, placed)
    assert straight.samples == into.samples == 4
    assert straight.most[-1] == 0
    assert into.most[0] == 0
    assert into.most[-1] == 1
    bounds = risk(aside, PlacedForecast.of(forecast, seen, mapper.origin))  # nobody says where its samples lie
    assert bounds.samples == 0
    assert 0.2 < bounds.least[-1] < bounds.independent[-1] <= bounds.most[-1]  # no single cell of it is sure


def test_without_evidence_what_is_even_was_never_seen(street: tuple[RolloutForecaster, Seen, Mapper]) -> None:
    forecaster, seen, mapper = street
    assert mapper.origin is not None
    forecast = forecaster.forecast(seen, 2)
    placed = PlacedForecast.of(forecast, seen, mapper.origin)
    plain = PlacedForecast.of(forecast, {**seen, "arrays": {}}, mapper.origin)
    assert plain.present.shape == (64, 64)
    assert not plain.known.all()
    np.testing.assert_array_equal(plain.known, placed.known)
    occupancy, label = seen["occupancy"].clone(), seen["label"].clone()
    occupancy[0, -1, 0, :5] = torch.tensor([0.5, 0.52, 0.53, 0.47, 0.5])  # 0.06 of mass moves it by 0.03
    label[0, -1, 0, :5] = torch.tensor([UNKNOWN] * 4 + [FREE])
    edited = cast(Seen, {**seen, "arrays": {}, "occupancy": occupancy, "label": label})
    known = PlacedForecast.of(forecast, edited, mapper.origin).known
    assert known[0, :5].tolist() == [False, False, True, True, True]


def test_one_window_is_placed_at_a_time(street: tuple[RolloutForecaster, Seen, Mapper]) -> None:
    _, seen, _ = street
    two = {**seen, "pose": seen["pose"].expand(2, -1, -1)}
    with pytest.raises(UserError, match="a batch of 2 windows: place the forecast of one at a time"):
        PlacedForecast.of(Forecast(seen["occupancy"]), cast(Seen, two), np.zeros(2))
