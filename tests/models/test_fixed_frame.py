"""The fixed frame: what a network reads of a window whose ego drives, and how its forecasts come back."""

from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from envpred.datamodules import Seen, WindowBatch
from envpred.datamodules.symmetry import turn_grid
from envpred.datamodules.variants import variant
from envpred.datamodules.windows import Draw, WindowDataset, collate
from envpred.errors import UserError
from envpred.mapping.shift import placed
from envpred.models import PredNetForecaster
from envpred.models.checkpoints import read_checkpoint
from envpred.models.fixed_frame import FixedFrame, Reading, likeliest_cells
from envpred.models.loading import load_forecaster
from envpred.store import Store
from tests.models.trainers import grids, prednet, trainer
from tests.store.stores import write_store

EMPTY = torch.tensor([0.0, 0.0])
WORLD = torch.rand(2, 200, 200, generator=torch.Generator().manual_seed(0))  # masses that stand, cell (100, 100) at 0
CELLS, WIDE, GIVEN, HORIZONS = 16, 64, 3, 4


def cut(centre: tuple[int, int], cells: int) -> Tensor:
    """What a grid of `cells` at a centre cell holds of the world."""
    i, j = (c + 100 - cells // 2 for c in centre)
    return WORLD[:, i : i + cells, j : j + cells]


def driven(*centres: tuple[int, int], wide: bool = False) -> WindowBatch:
    """A window through the world by an ego at these cells; three frames are shown."""
    frames, centre = torch.stack([cut(c, CELLS) for c in centres])[None], torch.tensor([centres])
    pose = torch.cat([centre.float(), torch.zeros(1, len(centres), 1)], dim=2)
    both: dict[str, Tensor] = {"frames": frames, "centre_cell": centre, "pose": pose}
    seen: dict[str, Any] = {name: value[:, :GIVEN] for name, value in both.items()}
    seen |= {"time": 0.1 * torch.arange(1 - GIVEN, 1)[None], "resolution": torch.tensor([1 / 3])}
    if wide:
        seen["context"] = torch.stack([cut(c, WIDE) for c in centres[:GIVEN]])[None]
    future = {name: value[:, GIVEN:] for name, value in both.items()}
    return {"seen": seen, "future": future, "drive": ["a"], "start": torch.zeros(1), "index": torch.zeros(1)}  # type: ignore[typeddict-item]


STEPS = [(0, 0), (2, -1), (4, -2), (6, -3), (8, -4), (10, -5), (12, -6)]


def test_grids_are_laid_by_hand() -> None:
    grid = torch.tensor([[1.0, 2.0], [3.0, 4.0]])
    beyond = torch.full((3, 3), 9.0)
    assert placed(grid, (1, 0), beyond).tolist() == [[9, 9, 9], [1, 2, 9], [3, 4, 9]]
    assert placed(grid, (-1, 2), beyond).tolist() == [[9, 9, 3], [9, 9, 9], [9, 9, 9]]
    for outside in ((-2, 0), (3, 0), (0, -5), (0, 7)):
        assert torch.equal(placed(grid, outside, beyond), beyond)
    assert (beyond == 9).all()


@settings(deadline=None)
@given(st.tuples(st.integers(-9, 9), st.integers(-9, 9)), st.integers(1, 6), st.integers(1, 6))
def test_laid_there_and_back_is_the_same_where_both_know(at: tuple[int, int], n: int, size: int) -> None:
    grid = torch.arange(1.0, n * n + 1).view(n, n)
    there = placed(grid, at, torch.zeros(size, size))
    back = placed(there, (-at[0], -at[1]), torch.zeros(n, n))
    kept = back != 0
    assert torch.equal(back[kept], grid[kept])
    cells = [max(0, min(a + n, size) - max(a, 0)) for a in at]
    assert int(kept.sum()) == cells[0] * cells[1]


def test_a_world_that_stands_stands_still() -> None:
    """Of the wide grid, all frames are the same; of the judged one, where the cells have been seen."""
    batch = driven(*STEPS, wide=True)
    assert batch["future"] is not None
    cells = np.array(STEPS[GIVEN:])
    read = Reading.fixed(batch["seen"], 0, cells, EMPTY, 4, batch["future"])
    assert read.frame is not None
    # 8 cells further east and 4 south, and a margin of 8 on every side: in whole fours.
    assert (read.frame.before.tolist(), read.frame.after.tolist()) == ([8, 12], [16, 8])
    assert read.frames.shape == (1, 7, 2, CELLS + 24, CELLS + 20)
    assert torch.equal(read.frames, read.frames[:, :1].expand_as(read.frames))
    batch = driven(*STEPS)
    read = Reading.fixed(batch["seen"], 0, cells, EMPTY, 4, batch["future"])
    assert read.frames.shape == (1, 7, 2, CELLS, CELLS)
    last = read.frames[0, GIVEN - 1]
    assert torch.equal(last, cut(STEPS[GIVEN - 1], CELLS))
    for frame in read.frames[0]:
        assert torch.equal(frame[frame != 0], last[frame != 0])
    first = read.frames[0, 0, 0]  # it lies 4 cells further west and 2 further north: what it does not show is empty
    assert (first[:12, 2:] != 0).all()
    assert (first[12:] == 0).all()
    assert (first[:, :2] == 0).all()


def test_what_is_judged_lies_in_the_grid_of_its_frame() -> None:
    batch = driven(*STEPS)
    judged = Reading.fixed(batch["seen"], 0, np.array(STEPS[GIVEN:]), EMPTY, 4, batch["future"]).judged
    assert judged is not None
    # Of 16 x 16 cells, a grid (2, -1) k further shares (16 - 2 k)(16 - k).
    assert judged.sum((2, 3, 4))[0].tolist() == [12 * 14, 14 * 15, 256, 14 * 15, 12 * 14, 10 * 13, 8 * 12]
    assert not judged[0, 3, 0, :2].any()
    assert judged[0, 3, 0, 2:, :15].all()
    wide = driven(*STEPS, wide=True)
    judged = Reading.fixed(wide["seen"], 0, np.array(STEPS[GIVEN:]), EMPTY, 4, wide["future"]).judged
    assert judged is not None
    assert judged.sum((2, 3, 4))[0].tolist() == [256] * 7


@pytest.mark.parametrize("wide", [False, True])
def test_forecasts_come_back_to_the_ego(wide: bool) -> None:
    batch = driven(*STEPS, wide=wide)
    cells = np.array(STEPS[GIVEN:])
    read = Reading.fixed(batch["seen"], 0, cells, EMPTY, 4)
    still = read.frames[:, -1:].expand(-1, HORIZONS, -1, -1, -1)
    back = read.back(still)[0]
    for k, centre in enumerate(STEPS[GIVEN:]):
        truth = cut(centre, CELLS).clone()
        if not wide:
            truth[:, CELLS - 2 * (k + 1) :], truth[:, :, : k + 1] = 0, 0  # these enter
        assert torch.equal(back[k], truth)


def test_the_frame_ends_where_the_wide_grid_does() -> None:
    far = np.array([[40, 0]])
    frame = FixedFrame.of(np.array([0, 0]), CELLS, far, EMPTY, 13, 4)
    assert (frame.before.tolist(), frame.after.tolist()) == ([8, 8], [12, 8])
    probability = FixedFrame.of(np.array([0, 0]), CELLS, far, torch.tensor([0.5, 0.0]), 13, 4)
    unknown = probability.back(torch.rand(1, 2, 36, 32))
    assert (unknown[0, 0] == 0.5).all()
    assert (unknown[0, 1] == 0).all()


class Persistence(torch.nn.Module):
    """In PredNet's place: the frame read last stands."""

    def forward(self, frames: Tensor, given: int, steps: int) -> Tensor:
        shown = torch.cat([torch.zeros_like(frames[:, :1]), frames[:, : given - 1]], dim=1)
        return torch.cat([shown, frames[:, given - 1 : given].expand(-1, steps - given, -1, -1, -1)], dim=1)


def still(**options: Any) -> PredNetForecaster:
    model = prednet(fixed_frame=True, **options)
    model.network = Persistence()  # type: ignore[assignment]
    return model


@pytest.mark.parametrize("context", [False, True])
def test_an_even_drive_past_what_stands_is_forecast_exactly(context: bool) -> None:
    batch = driven(*STEPS, wide=context)
    assert batch["future"] is not None
    forecast = still(context=context).forecast(batch["seen"], HORIZONS)
    assert forecast.channels is not None
    if context:
        assert torch.equal(forecast.channels, batch["future"]["frames"])
    else:
        entered = (forecast.channels == 0).all(2)
        assert (forecast.probability[entered] == 0.5).all()
        assert torch.equal(forecast.channels[:, :, 0][~entered], batch["future"]["frames"][:, :, 0][~entered])


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three drives on a judged grid of 32 cells within 64."""
    folder = tmp_path_factory.mktemp("grids") / "grids"
    return write_store(folder, {name: list(range(30)) for name in "abc"}, cells=32, dogma=True, context=64)


def drawn(store: Path, draw: Draw, name: str, model: PredNetForecaster, crop: int | None) -> WindowBatch:
    data = grids(store, variant=name)
    data.trainer = type("T", (), {"lightning_module": model, "current_epoch": 0})()
    data.setup("test")
    places = data.datasets["test"].places
    return collate([WindowDataset(places, variant(name), 3, 5, model.needs, crop)[draw]])


@pytest.mark.parametrize("context", [False, True])
@pytest.mark.parametrize("symmetry", range(8))
def test_a_turned_window_is_forecast_turned(store: Path, context: bool, symmetry: int) -> None:
    model = still(context=context)
    upright, turned = (drawn(store, Draw(1, s), "dst_static", model, None) for s in (0, symmetry))
    expected = turn_grid(model.forecast(upright["seen"], 5).probability.numpy(), symmetry)
    np.testing.assert_array_equal(model.forecast(turned["seen"], 5).probability, expected)


@pytest.mark.parametrize("symmetry", [0, 3])
def test_of_a_crop_as_much_is_forecast_as_of_the_whole(store: Path, symmetry: int) -> None:
    """Where the ego goes moves the crop along; with the wide grid around it, nothing else changes."""
    model = still(context=True)
    whole, part = (drawn(store, Draw(1, symmetry, (5, 9)), "dst_static", model, crop) for crop in (None, 16))
    expected = model.forecast(whole["seen"], 5).probability[..., 5:21, 9:25]
    cropped = model.forecast(part["seen"], 5).probability
    assert np.array_equal(likeliest_cells(part["seen"], 0, 5) - likeliest_cells(whole["seen"], 0, 5), [[-3, 1]] * 5)
    torch.testing.assert_close(cropped[..., 2:-2, 2:-2], expected[..., 2:-2, 2:-2], rtol=0, atol=0)


def test_errors_count_where_they_are_judged() -> None:
    model = prednet(fixed_frame=True, first_scored=1)
    frames, predictions = torch.zeros(1, 3, 2, 2, 2), torch.zeros(1, 3, 2, 2, 2)
    predictions[:, 1, :, 0], predictions[:, 2] = 0.6, 0.2
    judged = torch.ones(1, 3, 1, 2, 2, dtype=torch.bool)
    judged[:, 2] = False
    judged[:, 1, :, 1, 1] = False
    assert model.t5_loss(frames, predictions, judged).item() == pytest.approx(0.5 * (0.6 + 0.6 + 0) / 3)
    frames = torch.rand(1, 5, 2, 16, 16)
    everywhere = torch.ones(1, 5, 1, 16, 16, dtype=torch.bool)
    torch.testing.assert_close(model.t1_loss(frames, everywhere), model.t1_loss(frames))
    wide = prednet(fixed_frame=True, layer_weights=[1.0, 0.3])
    torch.testing.assert_close(wide.t1_loss(frames, everywhere), wide.t1_loss(frames))
    some = torch.rand(1, 5, 1, 16, 16) < 0.5
    error = (frames - model.network(frames)).abs()[:, 1:].transpose(1, 2)
    expected = 0.5 * torch.cat([channel[some[:, 1:, 0]] for channel in error.unbind(1)]).mean()
    torch.testing.assert_close(model.t1_loss(frames, some), expected)


def test_what_is_not_judged_teaches_nothing(store: Path) -> None:
    """Targets outside of every judged grid may hold anything."""
    model = prednet(fixed_frame=True, context=True, t1_epochs=0, t5_error="squared", first_scored=3)
    batch = drawn(store, Draw(0), "dst_static", model, None)
    assert batch["future"] is not None
    cells = np.asarray(batch["future"]["centre_cell"][0], np.int64)
    read = Reading.fixed(batch["seen"], 0, cells, EMPTY, 2, batch["future"])
    assert read.judged is not None
    predictions = model.network(read.frames, given=3)
    frames = torch.where(read.judged, read.frames, 7.0)
    torch.testing.assert_close(
        model.t5_loss(frames, predictions, read.judged), model.t5_loss(read.frames, predictions, read.judged)
    )


@pytest.mark.parametrize("stage", ["t1", "t5"])
def test_validation_scores_what_a_test_would_forecast(store: Path, stage: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Wherever the ego went, the forecast goes by the frames shown."""
    model, scored = prednet(fixed_frame=True, context=True), []
    monkeypatch.setattr(PredNetForecaster, "stage", stage)
    monkeypatch.setattr(model, "score", lambda batch, forecast: scored.append(forecast.probability))
    monkeypatch.setattr(model, "log", lambda *args, **options: None)
    batch = drawn(store, Draw(0), "dst_static", model, None)
    assert batch["future"] is not None
    batch["future"]["centre_cell"] += torch.tensor([9, -7])
    with torch.no_grad():
        model.validation_step(batch, 0)
        torch.testing.assert_close(scored[0], model.forecast(batch["seen"], 5).probability, rtol=0, atol=0)


@pytest.mark.parametrize("name", ["dst_static", "prob_dogma"])
@pytest.mark.parametrize("context", [False, True])
def test_two_stages_run_and_the_checkpoint_forecasts_the_same(
    store: Path, tmp_path: Path, context: bool, name: str
) -> None:
    options = {"fixed_frame": True, "context": context, "variant": name}
    data = grids(store, variant=name, crop=16, batch_size=2)
    model = prednet(t1_epochs=1, t5_epochs=1, **options)
    run = trainer(tmp_path)
    run.fit(model, datamodule=data)
    file = tmp_path / "checkpoints" / "best.ckpt"
    assert read_checkpoint(file)["entered_t5"]
    run.test(model, datamodule=data, ckpt_path=file, weights_only=True, verbose=False)
    loaded = load_forecaster(file)
    batch = drawn(store, Draw(0), name, model, None)
    forecasts = [m.forecast(batch["seen"], 5).probability for m in (model, loaded)]
    assert torch.isfinite(forecasts[0]).all()
    torch.testing.assert_close(*forecasts, rtol=0, atol=0)
    with pytest.raises(UserError, match=r"fixed_frame True, the command says False"):
        run.test(prednet(variant=name), datamodule=data, ckpt_path=file, weights_only=True, verbose=False)


def test_a_batch_is_forecast_as_its_windows_are(store: Path) -> None:
    model = prednet(fixed_frame=True, context=True)
    single = [drawn(store, Draw(k), "dst_static", model, None)["seen"] for k in (0, 2)]
    one, other = (cast("dict[str, Tensor]", seen) for seen in single)
    both = cast(Seen, {name: torch.cat([one[name], other[name]]) for name in one if name != "arrays"})
    expected = torch.cat([model.forecast(seen, 5).probability for seen in single])
    torch.testing.assert_close(model.forecast(both, 5).probability, expected, rtol=0, atol=0)


def test_what_does_not_fit_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"--model\.context.*add --model\.fixed_frame$"):
        prednet(context=True)
    narrow = write_store(tmp_path / "narrow", {name: list(range(30)) for name in "abc"})
    with pytest.raises(UserError, match=r"--context 256"):
        trainer(tmp_path).fit(prednet(fixed_frame=True, context=True), datamodule=grids(narrow))
    assert Store(narrow).drives["a"].context is None


def test_a_dead_output_is_noticed_beside_cells_that_are_unknown(store: Path, tmp_path: Path) -> None:
    model = prednet(fixed_frame=True, variant="prob_static")
    torch.nn.init.constant_(cast(Tensor, model.network.predict[0].bias), -100.0)
    with pytest.raises(UserError, match="the same everywhere"):
        trainer(tmp_path).fit(model, datamodule=grids(store, variant="prob_static"))
