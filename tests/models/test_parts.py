"""What rollouts are made of."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from envpred.datamodules import Seen
from envpred.datamodules.windows import collate
from envpred.mapping.geometry import OCCUPIED
from envpred.mapping.movers import Movers
from envpred.mapping.world import World
from envpred.models import CorrectedRolloutForecaster, RolloutForecaster
from envpred.models.forecaster import Forecaster
from envpred.models.parts import hide_unseen, whole_world
from tests.models.trainers import grids
from tests.store.stores import write_store


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("grids") / "grids"
    return write_store(folder, {"a": list(range(40))}, cells=32, dogma=True, context=64, frame="ground")


def seen_by(model: Forecaster, store: Path) -> Seen:
    data = grids(store, split="custom", test=["a"])
    fake: Any = SimpleNamespace(lightning_module=model, current_epoch=0)
    data.trainer = fake
    data.setup("test")
    windows = data.datasets["test"]
    return collate([windows[0], windows[2]])["seen"]


def test_a_mover_is_where_it_has_come_to() -> None:
    """10 m/s to the east are 3 cells of 1/3 m in 0.1 s; what has left the context is nowhere."""
    cell, velocity = np.array([[101, 203]]), np.array([[10, 0]], np.float32)
    movers = Movers(cell, velocity, np.zeros((1, 3), np.float32), np.array([[0.7, 0.6, 0.5]], np.float32))
    standing = World(np.full((1, 16, 16), 0.1, np.float32))
    found = whole_world(standing, movers, np.array([100, 200]), (3, 0.1, 1 / 3))
    expected = np.full((3, 16, 16), 0.1, np.float32)
    expected[0, 12, 11], expected[1, 15, 11] = 0.7, 0.6
    np.testing.assert_array_equal(found, expected)


def test_where_nobody_looks_is_unknown() -> None:
    found = np.zeros((2, 6, 6), np.float32)
    hide_unseen(found, np.array([[1, 2], [-3, 0]]), np.array([[4, 6], [2, 9]]))
    expected = np.full((2, 6, 6), np.nan, np.float32)
    expected[0, 1:4, 2:], expected[1, :2] = 0, 0
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("world", ["label", "hits"])
def test_a_rollout_gives_out_its_world_and_its_forecast(store: Path, world: Any) -> None:
    model = RolloutForecaster(given=3, world=world, movers=world == "hits")
    seen = seen_by(model, store)
    parts = model.parts(seen, 5)
    assert parts.world.shape == (2, 5, 64, 64)
    torch.testing.assert_close(parts.rendered, model.forecast(seen, 5).probability, rtol=0, atol=0)
    assert parts.corrected is None
    unknown = parts.world.isnan()
    assert not unknown[:, :, 18:48, 16:48].any()  # under the judged grids: the ego creeps east
    assert unknown[:, :, :15].all()
    if world == "label":
        hit = 0.97 * (seen["context_label"][:, -1:] == OCCUPIED).float().expand_as(parts.world)
        torch.testing.assert_close(parts.world[~unknown], hit[~unknown])
        assert (parts.world[~unknown] > 0).any()


def test_a_corrected_rollout_gives_out_both_forecasts(store: Path) -> None:
    sizes: dict[str, Any] = {"given": 3, "horizons": 5, "width": 8, "fine": 8, "head": 8}
    model = CorrectedRolloutForecaster(**sizes, corrects="forecast").eval()
    torch.nn.init.constant_(model.network.leave.bias, 1.0)  # type: ignore[arg-type]
    seen = seen_by(model, store)
    with torch.no_grad():
        parts, forecast = model.parts(seen, 5), model.forecast(seen, 5).probability
    assert parts.corrected is not None
    torch.testing.assert_close(parts.corrected, forecast, rtol=0, atol=0)
    torch.testing.assert_close(parts.rendered, RolloutForecaster(given=3).forecast(seen, 5).probability)
    assert (parts.corrected - parts.rendered).abs().max() > 0.05
