"""What is not a number ends a run in one line, which names what it is and where."""

from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from envpred.callbacks import ResultWriter
from envpred.cli import main
from envpred.datamodules import Forecast, Seen, WindowBatch
from envpred.errors import UserError
from envpred.metrics.windows import HorizonMetric
from envpred.models import LastFrame
from envpred.models.forecaster import Forecaster
from envpred.models.numbers import check_forecast
from envpred.results.result import RESULT
from envpred.store import Store
from tests.models.trainers import grids, prednet, trainer
from tests.remedies import refusal, remedy
from tests.store.stores import write_store


def spoiled_network() -> Forecaster:
    model = prednet()
    with torch.no_grad():
        for weights in model.parameters():
            weights.fill_(torch.nan)
    return model


@pytest.mark.parametrize("stage", ["test", "validate", "predict"])
def test_a_forecast(store: Path, tmp_path: Path, stage: str) -> None:
    run = trainer(tmp_path)
    with pytest.raises(UserError, match=r"forecast of PredNetForecaster is not a number 1 frames .* of [abc] from"):
        getattr(run, stage)(spoiled_network(), datamodule=grids(store))
    assert not (tmp_path / RESULT).exists()


def test_a_forecast_by_other_weights(store: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="is not a number") as failure:
        trainer(tmp_path).test(spoiled_network(), datamodule=grids(store))
    ((option,),) = remedy(failure.value)
    trained = trainer(tmp_path / "trained", max_epochs=1)
    trained.fit(prednet(), datamodule=grids(store))
    (file, *_) = (tmp_path / "trained").rglob("*.ckpt")
    other = {option.removeprefix("--"): str(file)}
    trainer(tmp_path / "tested").test(spoiled_network(), datamodule=grids(store), verbose=False, **other)  # type: ignore[arg-type]


class Diverges(Forecaster):
    """Its loss is lost in its second step."""

    def __init__(self) -> None:
        super().__init__(given=3)
        self.level = torch.nn.Parameter(torch.zeros(()))

    def forecast(self, seen: Seen, horizons: int) -> Forecast:
        return Forecast(seen["occupancy"][:, -1:].expand(-1, horizons, -1, -1) + 0 * self.level.nan_to_num())

    def training_step(self, batch: WindowBatch, batch_index: int) -> Tensor:
        return self.level * (torch.nan if batch_index == 1 else 1)


def test_a_loss(store: Path, tmp_path: Path) -> None:
    run = trainer(tmp_path, max_epochs=2)
    with pytest.raises(UserError, match="training loss is not a number, in epoch 0 at step 4 or up to") as failure:
        run.fit(Diverges(), datamodule=grids(store))
    (verify,) = remedy(failure.value)
    main([*verify, "--store", str(store)])
    assert not list(tmp_path.rglob("*.ckpt"))


def test_grids(tmp_path: Path) -> None:
    """A flipped bit that makes a number none."""
    store = write_store(tmp_path / "grids", {name: list(range(24)) for name in "abc"})
    module = grids(store, test=["c"])
    module.setup("test")  # compares checksums; the bit flips afterwards
    evidence = np.load(Store(store).folder / "c" / "evidence.npy", mmap_mode="r+")
    evidence[6, 0, 3, 4] = np.nan
    evidence.flush()
    batch = next(iter(module.test_dataloader()))
    where = "the targets hold what is not a number in the window of c from frame 0 on"
    with pytest.raises(UserError, match=where) as failure:
        check_forecast("LastFrame", batch, torch.zeros(1, 5, 16, 16))
    (verify,) = remedy(failure.value)
    assert "c/evidence.npy: its content has changed" in refusal([*verify, "--store", str(store)])


class Sometimes(HorizonMetric):
    """Undefined where it should not be."""

    def measure(self, forecast: Tensor, target: Tensor, last: Tensor) -> Tensor:
        values = (forecast - target).mean((2, 3))
        values[:, 2] = torch.nan if forecast[0, 0, 0, 0] >= 0 and not self.rows_state else 0.0
        return values


def test_a_metric(store: Path, tmp_path: Path) -> None:
    run = trainer(tmp_path)
    run.callbacks = [ResultWriter(metrics=[Sometimes])]  # type: ignore[attr-defined]
    with pytest.raises(UserError, match="metric sometimes is not a number 3 frames ahead in window 0;") as failure:
        run.test(LastFrame(given=3), datamodule=grids(store, test=["c"]), verbose=False)
    (verify,) = remedy(failure.value)
    main([*verify, "--store", str(store)])
    assert not (tmp_path / RESULT).exists()
