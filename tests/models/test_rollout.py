"""The rollout as a forecaster: what it needs, what it refuses, and what its forecasts are worth."""

import json
import multiprocessing
from pathlib import Path

import numpy as np
import pytest
import torch

from envpred.errors import UserError
from envpred.models import RolloutForecaster, RolloutOracle
from envpred.models.forecaster import Forecaster
from envpred.models.rollout import threads
from envpred.results.result import RESULT
from envpred.store import Store
from tests.models.trainers import grids, trainer
from tests.store.stores import write_store


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive on which the ego creeps east past a wall, on a judged grid of 32 cells within 64."""
    folder = tmp_path_factory.mktemp("grids") / "grids"
    return write_store(folder, {"a": list(range(40))}, cells=32, dogma=True, context=64)


def scores_of(model: Forecaster, store: Path, folder: Path) -> dict[str, np.ndarray]:
    trainer(folder).test(model, datamodule=grids(store, split="custom", test=["a"]), verbose=False)
    result = json.loads((folder / RESULT).read_text())
    return {name: np.array(result["metrics"][name]["mean"]) for name in ("mse", "static_mse")} | {"result": result}


@pytest.mark.parametrize("options", [{"world": "label"}, {"world": "hits"}, {"context": False}, {"futures": 1}])
def test_it_runs_without_training(store: Path, tmp_path: Path, options: dict[str, object]) -> None:
    found = scores_of(RolloutForecaster(given=3, **options), store, tmp_path)  # type: ignore[arg-type]
    assert np.isfinite(found["mse"]).all()
    assert found["result"]["role"] == "rollout"
    wide = {"context_evidence", "context_label"} if options.get("context", True) else set()
    assert set(found["result"]["data"]["input_hash"]) == wide


def test_same_seed_same_bits_whatever_the_threads_and_the_batch(store: Path) -> None:
    model = RolloutForecaster(given=3)
    data = grids(store, split="custom", test=["a"], batch_size=2)
    data.trainer = type("T", (), {"lightning_module": model, "current_epoch": 0})()
    data.setup("test")
    batch = next(iter(data.test_dataloader()))
    first = model.forecast(batch["seen"], 5).probability
    threads = torch.get_num_threads()
    torch.set_num_threads(2 if threads == 1 else 1)
    try:
        again = model.forecast(batch["seen"], 5).probability
    finally:
        torch.set_num_threads(threads)
    torch.testing.assert_close(first, again, rtol=0, atol=0)
    data.batch_size = 1
    one = model.forecast(next(iter(data.test_dataloader()))["seen"], 5).probability
    torch.testing.assert_close(one[0], first[0], rtol=0, atol=0)


def cast() -> None:
    assert list(threads().map(abs, [-1, 2])) == [1, 2]


def test_a_fork_has_threads_of_its_own() -> None:
    """Those of the process that it was forked from do not go on in it, and would be waited for without end."""
    cast()
    assert threads() is threads()
    fork = multiprocessing.get_context("fork").Process(target=cast, daemon=True)
    fork.start()
    fork.join(30)
    assert fork.exitcode == 0


def test_samples_have_the_forecast_for_their_mean(store: Path) -> None:
    model = RolloutForecaster(given=3, futures=64, samples=True)
    data = grids(store, split="custom", test=["a"])
    data.trainer = type("T", (), {"lightning_module": model, "current_epoch": 0})()
    data.setup("test")
    forecast = model.forecast(next(iter(data.test_dataloader()))["seen"], 5)
    assert forecast.samples is not None
    assert forecast.samples.shape == (1, 64, 5, 32, 32)
    assert (forecast.samples.mean(1) - forecast.probability).abs().mean() < 0.03


def test_the_oracle_drives_where_the_ego_drove(store: Path, tmp_path: Path) -> None:
    """The ego drives evenly, so its true future is the likeliest one."""
    oracle = scores_of(RolloutOracle(given=3, world="label"), store, tmp_path / "oracle")
    likeliest = scores_of(RolloutForecaster(given=3, world="label", futures=1), store, tmp_path / "one")
    np.testing.assert_allclose(oracle["mse"], likeliest["mse"], rtol=0.2)
    assert oracle["result"]["role"] == "oracle"


def test_what_it_cannot_roll_out_is_refused(store: Path, tmp_path: Path) -> None:
    narrow = write_store(tmp_path / "narrow", {"a": list(range(40))}, cells=32)
    with pytest.raises(UserError, match=r"--context 256"):
        scores_of(RolloutForecaster(given=3), narrow, tmp_path / "a")
    with pytest.raises(UserError, match=r"relative to the ego.*--config ground_velocity"):
        scores_of(RolloutForecaster(given=3, movers=True), store, tmp_path / "b")
    with pytest.raises(UserError, match=r"--model\.futures 0"):
        RolloutForecaster(futures=0)
    assert Store(store).drives["a"].context is not None
