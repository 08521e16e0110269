"""The network on top of the rollout: it starts as the rollout, learns, and reads windows that are turned alike."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from lightning.pytorch import seed_everything

from envpred.datamodules import GridDataModule
from envpred.datamodules.windows import Draw, collate
from envpred.errors import UserError
from envpred.models import CorrectedRolloutForecaster, RolloutForecaster
from envpred.models.corrected_rollout import _divided, _extent
from envpred.models.forecaster import Forecaster
from envpred.models.loading import load_forecaster
from envpred.networks.correction import FACTOR
from envpred.results.result import RESULT
from tests.models.trainers import grids, trainer
from tests.store.stores import write_store

SMALL: dict[str, Any] = {"given": 3, "horizons": 5, "width": 8, "fine": 8, "head": 4, "futures": 2, "max_epochs": 2}


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    drives = {name: list(range(24)) for name in "abc"}
    folder = tmp_path_factory.mktemp("grids") / "grids"
    return write_store(folder, drives, cells=32, dogma=True, context=64, frame="ground")


def module(store: Path, model: Forecaster, **options: Any) -> GridDataModule:
    """A data module that serves `model`."""
    data = grids(store, **options)
    fake: Any = SimpleNamespace(lightning_module=model, current_epoch=0)
    data.trainer = fake
    data.setup("fit")
    return data


@pytest.mark.parametrize("corrects", ["forecast", "world"])
@pytest.mark.parametrize("movers", [False, True])
def test_untrained_it_is_the_rollout(store: Path, movers: bool, corrects: Any) -> None:
    corrected = CorrectedRolloutForecaster(**SMALL, movers=movers, corrects=corrects).eval()
    rollout = RolloutForecaster(given=3, futures=2, movers=movers)
    seen = collate([module(store, corrected).datasets["val"][0]])["seen"]
    with torch.no_grad():
        forecast = corrected.forecast(seen, 5).probability
    expected = rollout.forecast(seen, 5).probability
    torch.testing.assert_close(forecast, expected.clamp(0.002, 0.998), atol=2e-5, rtol=0)


@pytest.mark.parametrize(("corrects", "lr", "samples"), [("forecast", 0.02, 30), ("world", 0.1, 60)])
def test_it_learns_and_its_checkpoint_forecasts(
    store: Path, tmp_path: Path, corrects: Any, lr: float, samples: int
) -> None:
    seed_everything(1, verbose=False)
    model = CorrectedRolloutForecaster(**SMALL, scored=3, lr=lr, corrects=corrects)
    run = trainer(tmp_path)
    run.fit(model, datamodule=grids(store, samples=samples, crop=None))
    best = tmp_path / "checkpoints" / "best.ckpt"
    trained = load_forecaster(best)
    for name, forecaster in (("trained", trained), ("rollout", RolloutForecaster(given=3, futures=2))):
        trainer(tmp_path / name).test(forecaster, datamodule=grids(store, test=["c"]), verbose=False)
    mse = {
        name: np.mean(json.loads((tmp_path / name / RESULT).read_text())["metrics"]["mse"]["mean"])
        for name in ("trained", "rollout")
    }
    assert mse["trained"] < (0.9 if corrects == "forecast" else 0.93) * mse["rollout"]


@pytest.mark.parametrize("symmetry", range(8))
@pytest.mark.parametrize("world", ["label", "hits"])
def test_turned_windows_have_turned_forecasts(store: Path, symmetry: int, world: Any) -> None:
    """Poses, lattice, sensor and body turn with the grid; one cell at the border may differ where it is mirrored."""
    model = RolloutForecaster(given=3, futures=1, world=world)
    windows = module(store, model).datasets["train"]
    plain, turned = (collate([windows[Draw(2, k)]])["seen"] for k in (0, symmetry))
    expected, found = (model.forecast(seen, 5).probability[0].numpy() for seen in (plain, turned))
    if symmetry & 1:
        expected = expected.swapaxes(-1, -2)
    expected = expected[..., ::-1, :] if symmetry & 2 else expected
    expected = expected[..., ::-1] if symmetry & 4 else expected
    differs = np.abs(found - expected) > 0.02
    assert differs[:, 2:-2, 2:-2].mean() < 0.02


def test_a_trained_correction_counts_half_where_the_ego_stands(store: Path) -> None:
    model = CorrectedRolloutForecaster(**SMALL, corrects="forecast").eval()
    torch.nn.init.constant_(model.network.leave.bias, 1.0)  # type: ignore[arg-type]
    seen = collate([module(store, model).datasets["val"][0]])["seen"]
    seen["pose"] = seen["pose"][:, -1:].expand_as(seen["pose"]).clone()
    rolled = RolloutForecaster(given=3, futures=2).forecast(seen, 5).probability
    which = torch.arange(5)
    with torch.no_grad():
        whole = model._corrected(seen, 5, which)
        half = model.forecast(seen, 5).probability
    torch.testing.assert_close(half, 0.5 * whole + 0.5 * rolled, atol=1e-3, rtol=0)
    assert (whole - rolled).abs().max() > 0.05


def test_its_samples_have_the_corrected_forecast_for_their_mean(store: Path) -> None:
    model = CorrectedRolloutForecaster(**(SMALL | {"futures": 16}), corrects="forecast", samples=True).eval()
    torch.nn.init.constant_(model.network.leave.bias, 1.0)  # type: ignore[arg-type]
    seen = collate([module(store, model).datasets["val"][0]])["seen"]
    with torch.no_grad():
        forecast = model.forecast(seen, 5)
    rolled = RolloutForecaster(given=3, samples=True).forecast(seen, 5)
    assert forecast.samples is not None
    assert forecast.samples.shape == (1, 16, 5, 32, 32)
    torch.testing.assert_close(forecast.samples.mean(1), forecast.probability, atol=1e-5, rtol=0)
    assert (forecast.probability - rolled.probability).abs().max() > 0.05
    assert forecast.samples.var(1).max() > 0.01


@pytest.mark.parametrize("moved", [[[0, 0]], [[3, 0], [40, 2]], [[-50, 9], [-80, 90]]])
def test_the_canvas_lies_in_the_context_and_divides(moved: list[list[int]]) -> None:
    low, high = _divided(*_extent(np.array(moved) + 64, n=128, cells=256), 256)
    assert (low >= 0).all()
    assert (high <= 256).all()
    assert ((high - low) % FACTOR == 0).all()
    inside = np.clip(np.array([[0, 0], *moved]) + 64, 0, 128)  # as far as the context goes
    assert (low <= inside.min(axis=0)).all()
    assert (high >= np.minimum(inside.max(axis=0) + 128, 256)).all()


def test_bad_sizes_are_refused(store: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"--model\.width 12"):
        CorrectedRolloutForecaster(width=12)
    few = CorrectedRolloutForecaster(**(SMALL | {"horizons": 4}))
    with pytest.raises(UserError, match="reaches 4 frames ahead"):
        trainer(tmp_path).test(few, datamodule=grids(store, test=["c"]), verbose=False)


def test_samples_of_a_corrected_world_are_drawn_from_it(store: Path) -> None:
    """Their mean is the corrected forecast, and not the rollout's."""
    model = CorrectedRolloutForecaster(**(SMALL | {"futures": 64}), corrects="world", samples=True).eval()
    torch.nn.init.constant_(model.network.leave.bias, -2.0)  # type: ignore[arg-type]
    seen = collate([module(store, model).datasets["val"][0]])["seen"]
    with torch.no_grad():
        found, parts = model.forecast(seen, 5), model.parts(seen, 5)
    rolled = RolloutForecaster(given=3, futures=64).forecast(seen, 5).probability
    assert found.samples is not None
    torch.testing.assert_close(parts.rendered, rolled)
    assert parts.corrected is not None
    torch.testing.assert_close(parts.corrected, found.probability)
    away = (found.samples.mean(1) - found.probability).abs().mean()
    assert (rolled - found.probability).abs().mean() > 4 * away
