"""PredNet as a forecaster: trained on the next frame first (t+1), then on its own forecasts (t+5), in one run."""

from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
import torch
from lightning.pytorch.callbacks import Callback, ModelCheckpoint
from lightning.pytorch.trainer.states import TrainerFn
from lightning.pytorch.utilities import rank_zero_info, rank_zero_warn
from torch import Tensor

from envpred.datamodules import Forecast, Future, Needs, Seen, WindowBatch
from envpred.errors import UserError, check_number, one_line
from envpred.gate import read_arrays
from envpred.gate.runs import keras_weights
from envpred.models.checkpoints import StageCheckpoint, read_checkpoint
from envpred.models.fixed_frame import Cells, Reading, likeliest_cells
from envpred.models.forecaster import Forecaster
from envpred.networks.prednet import PredNet

# A forecast whose cells differ by less than this over a whole validation says nothing: its output has died.
DEAD = 1e-6
_LITTLE = 0.01  # static error that is added: where nothing happens there is nothing to win


class PredNetForecaster(Forecaster):
    """PredNet with the two-stage schedule of Itkina et al. 2019.

    Stage t+1 minimises the error of the prediction of the next frame, all frames shown; stage t+5 starts from its best
    weights with a fresh optimiser and minimises the error of the predictions after `given` frames, which are fed back.

    Args:
        variant: input variant; decides the channels of the first layer.
        given: frames shown before the first that is forecast.
        channels: channels of the layers above the first.
        feedback: what is read once no frames are shown (see `envpred.networks.prednet.PredNet`).
        layer_weights: weight of each layer's error in stage t+1; layers that are not named weigh nothing.
        t1_epochs: epochs of stage t+1; 0 leaves it out.
        t1_lr: its learning rate.
        t1_drop_epoch: its epoch from which the learning rate is multiplied by `lr_drop`.
        t5_epochs: epochs of stage t+5; 0 leaves it out.
        t5_lr: its learning rate.
        t5_drop_epoch: its epoch from which the learning rate is multiplied by `lr_drop`.
        lr_drop: factor on the learning rate.
        first_scored: first frame that the loss of stage t+5 counts; 1 as in the paper, or `given` for forecasts alone.
        t5_error: what the loss of stage t+5 averages: absolute errors as in the paper, whose best forecast is the
            median and stays sharp; squared ones, whose best forecast is the mean and scores a lower MSE; or these as a
            share of the static baseline's in the same frame, so that windows in which little changes count, too.
        fixed_frame: read all frames on the grid of the last one shown, on which what stands, stands still; forecasts
            are then moved to where the ego is likeliest to be, and cells that were not read are unknown.
        context: read the wide grid in the fixed frame, as far as the ego may go.
        init_from: weights that training starts from: name of those that ship, checkpoint (.ckpt), Keras arrays (.npz).
    """

    shaping = ("variant", "channels", "feedback", "fixed_frame", "context")

    def __init__(
        self,
        variant: str = "dst_static",
        given: int = 5,
        channels: list[int] = [48, 96, 192],  # noqa: B006 - read only, and the command line shows it
        feedback: Literal["stale", "current"] = "stale",
        layer_weights: list[float] = [1.0],  # noqa: B006
        t1_epochs: int = 100,
        t1_lr: float = 1e-4,
        t1_drop_epoch: int = 75,
        t5_epochs: int = 100,
        t5_lr: float = 1e-4,
        t5_drop_epoch: int = 75,
        lr_drop: float = 0.1,
        first_scored: int = 1,
        t5_error: Literal["absolute", "squared", "share"] = "absolute",
        init_from: str | None = None,
        fixed_frame: bool = False,
        context: bool = False,
    ) -> None:
        super().__init__(variant, given)
        self.save_hyperparameters()
        if context and not fixed_frame:
            raise UserError("--model.context: the wide grid is read in one frame; add --model.fixed_frame")
        self.needs = Needs(context=context)
        inputs = len(self.view.channels)
        if not 1 <= len(layer_weights) <= len(channels) + 1 or min(layer_weights) < 0 or max(layer_weights) == 0:
            most = len(channels) + 1
            raise UserError(f"--model.layer_weights {layer_weights}: give 1 to {most} numbers, none below 0, one above")
        if min(t1_epochs, t5_epochs) < 0 or t1_epochs + t5_epochs == 0:
            epochs = f"--model.t1_epochs {t1_epochs}, --model.t5_epochs {t5_epochs}"
            raise UserError(f"{epochs}: give numbers of which none is below 0, and one above")
        if not channels or min(channels) < 1:
            raise UserError(f"--model.channels {channels}: give at least one number, each of at least 1")
        for name in ("t1_lr", "t5_lr", "lr_drop", "t1_drop_epoch", "t5_drop_epoch"):
            check_number(f"model.{name}", self.hparams[name])
        signed = tuple(self.view.velocity or ())
        self.network = PredNet((inputs, *channels), feedback=feedback, signed_channels=signed)
        while len(layer_weights) > 1 and layer_weights[-1] == 0:
            layer_weights = layer_weights[:-1]  # the errors of layers without weight are not worth computing
        self.register_buffer("layer_weights", torch.tensor(layer_weights), persistent=False)
        self.layer_weights: Tensor
        self.entered_t5 = t1_epochs == 0
        self.register_buffer("spread", torch.zeros(()), persistent=False)
        self.spread: Tensor

    @property
    def epochs(self) -> int:
        return int(self.hparams["t1_epochs"] + self.hparams["t5_epochs"])

    @property
    def stage(self) -> Literal["t1", "t5"]:
        """The stage of the trainer's current epoch; what is not being trained is in its last stage."""
        training = self.trainer.state.fn == TrainerFn.FITTING
        return "t1" if training and self.trainer.current_epoch < self.hparams["t1_epochs"] else "t5"

    def forecast(self, seen: Seen, horizons: int) -> Forecast:
        given, channels = seen["frames"].shape[1], []
        for read in self._read(seen, self._told(seen, horizons)):
            predictions: Tensor = self.network(read.frames, given=given, steps=given + horizons)
            channels.append(read.back(predictions[:, given:]))
        return self._forecast(channels)

    def _forecast(self, channels: list[Tensor]) -> Forecast:
        """The forecast of all `channels` (B, N, C, H, W), in parts."""
        joined = channels[0] if len(channels) == 1 else torch.cat(channels)  # one keeps its layout in memory
        return Forecast(self.view.probability(joined).clamp(0, 1), joined)

    def _told(self, seen: Seen, horizons: int) -> list[Cells]:
        """Where the network is told that the future grids of each window lie; it is told nothing in the ego's frame."""
        windows = len(seen["frames"]) if self.hparams["fixed_frame"] else 0
        return [likeliest_cells(seen, b, horizons) for b in range(windows)]

    def _read(self, seen: Seen, told: list[Cells], future: Future | None = None) -> list[Reading]:
        """The batch as the network reads it: as one, or a window at a time, whose fixed frames differ in size."""
        if not self.hparams["fixed_frame"]:
            return [Reading(seen["frames"] if future is None else torch.cat([seen["frames"], future["frames"]], dim=1))]
        empty = torch.tensor(self.view.empty, device=seen["frames"].device)
        multiple = 2 ** len(self.hparams["channels"])
        return [Reading.fixed(seen, b, cells, empty, multiple, future) for b, cells in enumerate(told)]

    def t1_loss(self, frames: Tensor, judged: Tensor | None = None) -> Tensor:
        """Error of the prediction of every frame but the first, all frames shown, weighed over layers.

        Layer 0's is counted in the cells `judged` (B, T, 1, H, W) if they are given.
        """
        found = self.network.unroll(frames, error_layers=len(self.layer_weights))
        errors = found.errors[:, 1:].mean(dim=(0, 1))
        if judged is not None:
            lowest = 0.5 * _mean((frames - found.predictions)[:, 1:].abs(), judged[:, 1:])
            errors = torch.cat([lowest[None], errors[1:]])
        return (errors * self.layer_weights).sum()

    def t5_loss(self, frames: Tensor, predictions: Tensor, judged: Tensor | None = None) -> Tensor:
        """Half the mean error from `first_scored` on: the scale of the split errors of stage t+1.

        It is counted in the cells `judged` (B, T, 1, H, W) if they are given.
        """
        first = int(self.hparams["first_scored"])
        error = frames[:, first:] - predictions[:, first:]
        error = error.abs() if self.hparams["t5_error"] == "absolute" else error.square()
        if self.hparams["t5_error"] == "share":
            static = (frames[:, first:] - frames[:, self.given - 1 : self.given]).square().mean((2, 3, 4), keepdim=True)
            error = 0.1 * error / (static + _LITTLE)
        return 0.5 * _mean(error, None if judged is None else judged[:, first:])

    def training_step(self, batch: WindowBatch, batch_index: int) -> Tensor:
        future, stage, losses = batch["future"], self.stage, []
        assert future is not None
        for read in self._read(batch["seen"], _cells(future), future):
            if stage == "t1":
                losses.append(self.t1_loss(read.frames, read.judged))
            else:
                losses.append(self.t5_loss(read.frames, self.network(read.frames, given=self.given), read.judged))
        loss = torch.stack(losses).mean()
        self.log(f"train/loss_{stage}", loss, prog_bar=True, on_step=True, batch_size=len(batch["index"]))
        return loss

    def validation_step(self, batch: WindowBatch, batch_index: int) -> None:
        seen, future, stage, losses, channels = batch["seen"], batch["future"], self.stage, [], []
        assert future is not None
        # As at test, the network is told where the ego is likeliest to go, not where it went.
        for read in self._read(seen, self._told(seen, future["frames"].shape[1]), future):
            predictions = self.network(read.frames, given=self.given)
            made = self.view.probability(predictions[:, self.given :])  # before cells that are unknown come to it
            self.spread = torch.maximum(self.spread, made.amax() - made.amin())
            channels.append(read.back(predictions[:, self.given :]))
            if stage == "t1":
                losses.append(self.t1_loss(read.frames, read.judged))
            else:
                losses.append(self.t5_loss(read.frames, predictions, read.judged))
        self.log(f"val/loss_{stage}", torch.stack(losses).mean(), batch_size=len(batch["index"]), sync_dist=True)
        self.score(batch, self._forecast(channels))

    def on_validation_epoch_start(self) -> None:
        self.spread.zero_()

    def on_validation_epoch_end(self) -> None:
        super().on_validation_epoch_end()
        spread = cast(Tensor, self.all_gather(self.spread)).max()
        if spread < DEAD and not self.trainer.sanity_checking:
            raise UserError(
                f"the forecast is the same everywhere (epoch {self.current_epoch}): PredNet's output has died and "
                "will not come back; give a smaller --model.t1_lr or another --seed_everything"
            )

    def on_train_epoch_start(self) -> None:
        if self.current_epoch == self.hparams["t1_epochs"] and not self.entered_t5:
            self._enter_t5()
        rate = self.learning_rate(self.current_epoch)
        for group in self.optimizers(use_pl_optimizer=False).param_groups:  # type: ignore[union-attr]
            group["lr"] = rate
        self.log("lr", rate)
        self.log("stage", float(self.stage == "t5"))

    def learning_rate(self, epoch: int) -> float:
        """The learning rate of an epoch; a function of its number alone, so that a resumed run goes on as before."""
        h = self.hparams
        stage, epoch = ("t1", epoch) if epoch < h["t1_epochs"] else ("t5", epoch - h["t1_epochs"])
        return float(h[f"{stage}_lr"] * (h["lr_drop"] if epoch >= h[f"{stage}_drop_epoch"] else 1.0))

    def _enter_t5(self) -> None:
        """Start stage t+5 from the best weights of stage t+1, with a fresh optimiser."""
        self.entered_t5 = True
        best = next((c.best_model_path for c in self._stage_checkpoints() if c.stage == "t1"), "")
        if best:
            self.load_state_dict(read_checkpoint(Path(best), self.device)["state_dict"])
            rank_zero_info(f"stage t+5 starts from {best}")
        else:
            rank_zero_warn("no checkpoint of stage t+1 was kept, so stage t+5 starts from its last weights")
        self.optimizers(use_pl_optimizer=False).state.clear()  # type: ignore[union-attr]

    def _stage_checkpoints(self) -> list[StageCheckpoint]:
        callbacks: list[Callback] = self.trainer.callbacks  # type: ignore[attr-defined]
        return [c for c in callbacks if isinstance(c, StageCheckpoint)]

    def configure_optimizers(self) -> torch.optim.Adam:
        return torch.optim.Adam(self.parameters(), lr=self.learning_rate(0), betas=(0.9, 0.999), eps=1e-8)

    def configure_callbacks(self) -> list[Callback]:
        """The best checkpoint of each stage by its own loss, and the last to resume from."""
        if not self.keeps_checkpoints:
            return []
        last = ModelCheckpoint(filename="last", save_on_train_epoch_end=True, enable_version_counter=False)
        return [StageCheckpoint("t1", "best_t1"), StageCheckpoint("t5", "best"), last]

    def setup(self, stage: str) -> None:
        super().setup(stage)
        channels, sides = self.hparams["channels"], {"grid": self.dataset.cells}
        if stage == "fit" and self.dataset.crop is not None:
            sides["--data.crop"] = self.dataset.crop
        halvings = len(channels)
        for what, cells in sides.items():
            if cells % 2**halvings:
                raise UserError(
                    f"--model.channels '{channels}': so many layers halve the grid {halvings} times, but the {what}'s "
                    f"side of {cells} cells is no multiple of {2**halvings}; give fewer"
                )
        first = int(self.hparams["first_scored"])
        if stage == "fit" and not 0 <= first < self.dataset.length:
            raise UserError(
                f"--model.first_scored {first}: windows have frames 0 to {self.dataset.length - 1}, so that nothing is "
                "left to train on; give one of these"
            )

    def initialise(self, source: str) -> None:
        file = Path(source)
        if file.suffix != ".npz":
            super().initialise(source)
            return
        remedy = "give arrays of the authors' Keras layer with this network's channels, or a checkpoint"
        arrays = read_arrays(file, keras_weights, remedy)
        try:
            self.network.load_state_dict(PredNet.from_keras(arrays).state_dict())
        except (ValueError, RuntimeError) as error:
            raise UserError(f"{file}: no Keras weights of this network ({one_line(error)}); {remedy}") from None
        rank_zero_info(f"weights: {file}")

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        super().on_save_checkpoint(checkpoint)
        checkpoint["entered_t5"] = self.entered_t5

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        super().on_load_checkpoint(checkpoint)
        self.entered_t5 = bool(checkpoint.get("entered_t5", self.entered_t5))
        theirs = checkpoint.get("hyper_parameters", {})
        if getattr(self, "_trainer", None) is not None and self.trainer.state.fn == TrainerFn.FITTING:
            changed = [f"{k} {v} (was {theirs[k]})" for k, v in self.hparams.items() if k in theirs and theirs[k] != v]
            if changed:
                rank_zero_info(f"resumed with other values than before, as the command says: {', '.join(changed)}")


def _cells(future: Future) -> list[Cells]:
    """Where the future grids of each window lay."""
    return [np.asarray(cells.cpu(), np.int64) for cells in future["centre_cell"]]


def _mean(error: Tensor, judged: Tensor | None) -> Tensor:
    """The mean of errors (B, T, C, H, W) over the cells `judged` (B, T, 1, H, W), or all."""
    if judged is None:
        return error.mean()
    return (error * judged).sum() / (judged.sum() * error.shape[2]).clamp(min=1)
