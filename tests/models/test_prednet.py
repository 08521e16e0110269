import csv
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import torch
from lightning.pytorch import Callback, Trainer
from torch import Tensor

from envpred.errors import UserError
from envpred.models import LastFrame, PredNetForecaster
from envpred.models.checkpoints import StageCheckpoint, read_checkpoint
from tests.models.trainers import LEAST, grids, prednet, seen, trainer
from tests.remedies import remedy


def losses(folder: Path) -> dict[int, tuple[str, str]]:
    """Training losses by step, as written: (stage's name, value)."""
    found = {}
    with (folder / "metrics.csv").open() as file:
        for row in csv.DictReader(file):
            for stage in ("t1", "t5"):
                if row.get(f"train/loss_{stage}"):
                    found[int(row["step"])] = (stage, row[f"train/loss_{stage}"])
    return found


def callbacks(run: Trainer) -> list[Callback]:
    return cast("list[Callback]", run.callbacks)  # type: ignore[attr-defined]


def best(run: Trainer, stage: str) -> Path:
    return next(Path(c.best_model_path) for c in callbacks(run) if isinstance(c, StageCheckpoint) and c.stage == stage)


class CrashError(Exception):
    pass


class StopAfter(Callback):
    """Ends the process's work as a crash would, once the checkpoints of an epoch are written."""

    def __init__(self, epoch: int) -> None:
        self.epoch = epoch

    def on_train_epoch_start(self, trainer: Trainer, pl_module: Any) -> None:
        if trainer.current_epoch == self.epoch:
            raise CrashError


def test_t1_loss_is_the_mean_error_of_all_frames_but_the_first() -> None:
    model = prednet(layer_weights=[1.0, 0.1])
    frames = torch.rand(2, 6, 2, 16, 16)
    errors = model.network.unroll(frames).errors
    expected = errors[:, 1:, 0].mean() + 0.1 * errors[:, 1:, 1].mean()
    torch.testing.assert_close(model.t1_loss(frames), expected)
    plain = prednet()
    plain.load_state_dict(model.state_dict())
    torch.testing.assert_close(plain.t1_loss(frames), errors[:, 1:, 0].mean())
    # Layer 0's error is the split error: half the mean absolute error over twice the channels.
    predictions = plain.network(frames)
    torch.testing.assert_close(plain.t1_loss(frames), 0.5 * (frames[:, 1:] - predictions[:, 1:]).abs().mean())


@pytest.mark.parametrize("first", [1, 3])
def test_t5_loss_by_hand(first: int) -> None:
    model = prednet(first_scored=first)
    frames, predictions = torch.zeros(1, 4, 2, 2, 2), torch.zeros(1, 4, 2, 2, 2)
    predictions[:, 0], predictions[:, 1], predictions[:, 3] = 9.0, 0.6, 0.2  # frame 0 counts nowhere
    expected = 0.5 * (0.6 + 0.0 + 0.2) / 3 if first == 1 else 0.5 * 0.2
    assert model.t5_loss(frames, predictions).item() == pytest.approx(expected)
    squared = prednet(first_scored=first, t5_error="squared")
    expected = 0.5 * (0.36 + 0.0 + 0.04) / 3 if first == 1 else 0.5 * 0.04
    assert squared.t5_loss(frames, predictions).item() == pytest.approx(expected)


def test_t5_loss_as_a_share_of_the_static_baselines_by_hand() -> None:
    """Three frames are shown; in the fourth half of the cells has changed by 1, static's squared error is 0.5."""
    model = prednet(first_scored=3, t5_error="share")
    frames, predictions = torch.zeros(2, 4, 2, 2, 2), torch.zeros(2, 4, 2, 2, 2)
    frames[0, 3, :, 0] = 1.0
    predictions[:, 3] = 0.2  # off by 0.8 where it has changed, by 0.2 elsewhere, and in the window that stands
    moving, standing = (0.64 + 0.04) / 2 / (0.5 + 0.01), 0.04 / 0.01
    expected = 0.5 * 0.1 * (moving + standing) / 2
    assert model.t5_loss(frames, predictions).item() == pytest.approx(expected, rel=1e-5)


def test_learning_rates_of_both_stages() -> None:
    model = prednet(t1_epochs=3, t1_lr=1e-3, t1_drop_epoch=2, t5_epochs=3, t5_lr=5e-4, t5_drop_epoch=1, lr_drop=0.1)
    np.testing.assert_allclose([model.learning_rate(e) for e in range(6)], [1e-3, 1e-3, 1e-4, 5e-4, 5e-5, 5e-5])


def test_forecast_is_the_pignistic_probability_of_predictions_after_those_shown() -> None:
    model = prednet()
    frames = torch.rand(1, 8, 2, 16, 16)
    predictions = model.network(frames, given=3)
    expected = 0.5 * predictions[:, 3:, 0] + 0.5 * (1 - predictions[:, 3:, 1])
    forecast = model.forecast(seen(frames=frames[:, :3]), 5)
    torch.testing.assert_close(forecast.probability, expected)
    torch.testing.assert_close(forecast.channels, predictions[:, 3:])


def test_two_stages_in_one_run(store: Path, tmp_path: Path) -> None:
    model, run = prednet(), trainer(tmp_path, callbacks=[])
    watched: dict[str, Tensor | int] = {}

    class Watch(Callback):
        def on_train_batch_start(self, trainer: Trainer, pl_module: Any, batch: Any, index: int) -> None:
            if trainer.current_epoch == 3 and index == 0:
                watched["state"] = len(trainer.optimizers[0].state)
                watched["weight"] = pl_module.network.gates[0].weight.detach().clone()

    callbacks(run).insert(0, Watch())
    run.fit(model, datamodule=grids(store))
    assert run.current_epoch == 6
    assert [stage for stage, _ in losses(tmp_path).values()] == ["t1"] * 12 + ["t5"] * 12
    assert watched["state"] == 0  # a fresh Adam
    weights = read_checkpoint(best(run, "t1"))["state_dict"]["network.gates.0.weight"]
    torch.testing.assert_close(watched["weight"], weights, rtol=0, atol=0)
    assert best(run, "t5").name == "best.ckpt"


@pytest.mark.parametrize("epoch", [1, 2, 3, 5])
def test_resuming_goes_on_exactly(store: Path, tmp_path: Path, epoch: int) -> None:
    """Stopped in stage t+1, at its end, at the start of stage t+5 and in it: same losses, same best checkpoints."""
    whole = trainer(tmp_path / "whole")
    whole.fit(prednet(), datamodule=grids(store))
    cut = trainer(tmp_path / "cut", callbacks=[StopAfter(epoch)])
    with pytest.raises(CrashError):
        cut.fit(prednet(), datamodule=grids(store))
    last = tmp_path / "cut" / "checkpoints" / "last.ckpt"
    rest = trainer(tmp_path / "rest")
    rest.fit(prednet(), datamodule=grids(store), ckpt_path=last, weights_only=True)
    joined = losses(tmp_path / "cut") | losses(tmp_path / "rest")
    assert len(losses(tmp_path / "rest")) == 24 - 4 * epoch
    assert joined == losses(tmp_path / "whole")
    a, b = (read_checkpoint(best(run, "t5"))["state_dict"] for run in (whole, rest))
    for name in a:
        torch.testing.assert_close(a[name], b[name], rtol=0, atol=0)


def test_best_checkpoint_has_the_lowest_validation_loss(store: Path, tmp_path: Path) -> None:
    run = trainer(tmp_path)
    run.fit(prednet(), datamodule=grids(store))
    with (tmp_path / "metrics.csv").open() as file:
        rows = list(csv.DictReader(file))
    for stage in ("t1", "t5"):
        values = {int(r["epoch"]): float(r[f"val/loss_{stage}"]) for r in rows if r.get(f"val/loss_{stage}")}
        assert read_checkpoint(best(run, stage))["epoch"] == min(values, key=lambda e: values[e])


def test_max_epochs_cuts_the_schedule_short(store: Path, tmp_path: Path) -> None:
    run = trainer(tmp_path, max_epochs=2)
    run.fit(prednet(), datamodule=grids(store))
    assert run.current_epoch == 2


def test_one_stage_alone(store: Path, tmp_path: Path) -> None:
    trainer(tmp_path / "t5").fit(prednet(t1_epochs=0, t5_epochs=1), datamodule=grids(store))
    assert {stage for stage, _ in losses(tmp_path / "t5").values()} == {"t5"}
    trainer(tmp_path / "t1").fit(prednet(t1_epochs=1, t5_epochs=0), datamodule=grids(store))
    assert {stage for stage, _ in losses(tmp_path / "t1").values()} == {"t1"}


def test_init_from_starts_from_weights_with_the_users_values(store: Path, tmp_path: Path) -> None:
    run = trainer(tmp_path / "first")
    run.fit(prednet(t1_epochs=1, t5_epochs=1), datamodule=grids(store))
    weights = read_checkpoint(best(run, "t5"))["state_dict"]
    model = prednet(t1_epochs=0, t5_epochs=1, t5_lr=0.0, init_from=str(best(run, "t5")))
    trainer(tmp_path / "second").fit(model, datamodule=grids(store))
    assert model.hparams["t5_lr"] == 0.0
    for name, value in model.state_dict().items():
        torch.testing.assert_close(value, weights[name], rtol=0, atol=0)  # nothing was learned at a rate of 0


def test_init_from_keras_arrays(store: Path, tmp_path: Path, shared: Path) -> None:
    file = shared / "reference" / "prednet_keras_c2.npz"
    model = prednet(channels=[8, 16], t1_epochs=1, t5_epochs=0, t1_lr=0.0, init_from=str(file))
    trainer(tmp_path).fit(model, datamodule=grids(store))
    with np.load(file) as arrays:
        np.testing.assert_array_equal(cast(Tensor, model.network.predict[0].bias).detach(), arrays["ahat_0/bias"])
    with pytest.raises(UserError, match=r"prednet_keras_c2\.npz"):
        trainer(tmp_path).fit(prednet(init_from=str(file)), datamodule=grids(store))


def test_users_values_win_when_resuming(store: Path, tmp_path: Path) -> None:
    first = trainer(tmp_path / "a", callbacks=[StopAfter(1)])
    with pytest.raises(CrashError):
        first.fit(prednet(), datamodule=grids(store))
    model, run = prednet(t1_lr=1e-5, t5_epochs=1), trainer(tmp_path / "b")
    run.fit(model, datamodule=grids(store), ckpt_path=tmp_path / "a" / "checkpoints" / "last.ckpt", weights_only=True)
    assert model.hparams["t1_lr"] == 1e-5
    assert run.current_epoch == 4
    with (tmp_path / "b" / "metrics.csv").open() as file:
        rates = [float(row["lr"]) for row in csv.DictReader(file) if row["lr"]]
    np.testing.assert_allclose(rates, [1e-5, 1e-6, 1e-3])


def test_checkpoints_of_another_variant_or_size_are_refused(store: Path, tmp_path: Path) -> None:
    run = trainer(tmp_path)
    run.fit(prednet(t1_epochs=0, t5_epochs=1), datamodule=grids(store))
    file = str(best(run, "t5"))
    cases = [
        (prednet(variant="prob_static"), grids(store, variant="prob_static"), "--data.variant dst_static"),
        (prednet(channels=[8]), grids(store), r"--model.channels '\[4\]'"),
        (LastFrame(given=3), grids(store), "holds a PredNetForecaster, not a LastFrame"),
    ]
    for model, data, line in cases:
        with pytest.raises(UserError, match=line):
            trainer(tmp_path / "test").test(model, datamodule=data, ckpt_path=file, weights_only=True, verbose=False)
    loaded = PredNetForecaster.load_from_checkpoint(file, weights_only=True)
    assert loaded.hparams["channels"] == [4]


def test_a_checkpoint_with_code_is_not_run(tmp_path: Path) -> None:
    class Code:
        def __reduce__(self) -> tuple[Any, ...]:
            return (Path(tmp_path / "was_run").touch, ())

    torch.save({"state_dict": Code()}, tmp_path / "evil.ckpt")
    with pytest.raises(UserError, match=r"evil\.ckpt: holds more than weights"):
        read_checkpoint(tmp_path / "evil.ckpt")
    assert not (tmp_path / "was_run").exists()


def test_damaged_checkpoints_are_named(tmp_path: Path) -> None:
    torch.save(LEAST | {"state_dict": {"a": torch.zeros(1000)}}, tmp_path / "good.ckpt")
    (tmp_path / "cut.ckpt").write_bytes((tmp_path / "good.ckpt").read_bytes()[:700])
    (tmp_path / "empty.ckpt").touch()
    torch.save([1], tmp_path / "other.ckpt")
    for name in ("cut.ckpt", "empty.ckpt", "other.ckpt", "missing.ckpt"):
        with pytest.raises(UserError, match=name):
            read_checkpoint(tmp_path / name)


def test_a_dead_output_is_noticed(store: Path, tmp_path: Path) -> None:
    model = prednet()
    torch.nn.init.constant_(model.network.predict[0].bias, -100.0)  # type: ignore[arg-type]
    with pytest.raises(UserError, match="the same everywhere") as failure:
        trainer(tmp_path).fit(model, datamodule=grids(store))
    (rate,), (seed,) = remedy(failure.value)
    torch.manual_seed({"--seed_everything": 4}[seed])
    slower = {rate.removeprefix("--model."): 1e-4}
    trainer(tmp_path).fit(prednet(t1_epochs=1, t5_epochs=0, **slower), datamodule=grids(store))


def test_dead_output_is_no_false_alarm_before_training(store: Path, tmp_path: Path) -> None:
    trainer(tmp_path, num_sanity_val_steps=1).fit(prednet(t1_epochs=1, t5_epochs=0), datamodule=grids(store))


def test_a_loss_that_counts_no_frame_is_refused(store: Path, tmp_path: Path) -> None:
    model = PredNetForecaster(channels=[4], first_scored=99)
    with pytest.raises(UserError, match=r"first_scored 99: windows have frames 0 to \d+, so that nothing is left"):
        trainer(tmp_path).fit(model, datamodule=grids(store))


def test_a_grid_that_cannot_be_halved_so_often_is_refused(store: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="16 cells is no multiple of 32"):
        trainer(tmp_path).fit(prednet(channels=[2] * 5), datamodule=grids(store))
    with pytest.raises(UserError, match=r"--data.crop's side of 6 cells is no multiple of 4"):
        trainer(tmp_path).fit(prednet(channels=[2] * 2), datamodule=grids(store, crop=6))


@pytest.mark.parametrize(
    "options", [{"layer_weights": [0.0]}, {"layer_weights": [1, 1, 1]}, {"layer_weights": []}, {"t1_epochs": -1}]
)
def test_values_out_of_range_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(UserError, match="--model"):
        prednet(**options)
