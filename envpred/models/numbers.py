"""What a forecaster gives is checked: its shape, and that losses, forecasts, grids and metrics are numbers."""

from collections.abc import Mapping
from typing import Any

import torch
from lightning.pytorch import LightningModule
from torch import Tensor

from envpred.datamodules import Forecast, Seen, WindowBatch
from envpred.errors import UserError
from envpred.metrics.windows import HorizonMetric, PerHorizon

ERRORS = ("mse", "static_mse")  # defined whatever is judged
LOOK = 50  # steps between looks at the loss: each waits for a GPU


class NumberedLoss(LightningModule):
    """A module whose training ends where its loss is not a number."""

    _lost: Tensor | None = None

    def on_before_backward(self, loss: Tensor) -> None:
        lost = ~loss.detach().isfinite()
        self._lost = lost if self._lost is None else self._lost | lost

    def on_train_batch_end(self, outputs: Any, batch: Any, batch_idx: int) -> None:
        if (batch_idx + 1) % LOOK == 0:
            self._check_loss()

    def on_train_epoch_end(self) -> None:
        self._check_loss()

    def on_validation_start(self) -> None:
        self._check_loss()

    def _check_loss(self) -> None:
        lost, self._lost = self._lost, None
        if lost is not None and bool(lost):
            raise UserError(
                f"the training loss is not a number, in epoch {self.current_epoch} at step {self.global_step} or up to "
                f"{LOOK} before it; train with a lower learning rate, and check the grids by `envpred verify`"
            )


def as_asked(method: str, forecast: Forecast, seen: Seen, horizons: int) -> Forecast:
    """The `forecast` of `method`, if it has the shape that was asked for.

    Raises:
        UserError: if it has other horizons, or other cells than what is seen.
    """
    windows, _, height, width = seen["occupancy"].shape
    asked = (windows, horizons, height, width)
    if tuple(forecast.probability.shape) != asked:
        raise UserError(
            f"{method} forecast {tuple(forecast.probability.shape)} where (windows, horizons, cells, cells) = {asked} "
            "was asked for; mend its `forecast`, or say how far it goes by `reachable`"
        )
    if forecast.samples is not None and forecast.samples[:, :1].shape != (windows, 1, *asked[1:]):
        drawn, wanted = tuple(forecast.samples.shape), (windows, "K", *asked[1:])
        raise UserError(f"{method} drew samples {drawn}, not {wanted}; mend its `forecast`")
    return forecast


def check_forecast(method: str, batch: WindowBatch, forecast: Tensor) -> None:
    """Refuse a forecast (B, horizons, H, W) of a `batch` that holds what is not a number, or was judged on such.

    Raises:
        UserError: naming the method, or the grids, and the window.
    """
    future = batch["future"]
    grids = {"grids shown": batch["seen"]["occupancy"], "forecast": forecast}
    if future is not None:
        grids = {"grids shown": grids["grids shown"], "targets": future["occupancy"], "forecast": forecast}
    for what, values in grids.items():
        lost = values.isnan().flatten(2)
        if not bool(lost.any()):
            continue
        window = int(lost.any(-1).any(-1).nonzero()[0])
        frame = int(lost[window].any(-1).nonzero()[0])
        where = f"in the window of {batch['drive'][window]} from frame {int(batch['start'][window])} on"
        if what == "forecast":
            raise UserError(
                f"the forecast of {method} is not a number {frame + 1} frames ahead, {where}; its weights are damaged "
                "or its training went astray: give another --ckpt_path"
            )
        raise UserError(f"the {what} hold what is not a number {where}; check the store by `envpred verify`")


def check_metrics(metrics: Mapping[str, Any], found: Mapping[str, Any]) -> None:
    """Refuse a metric over windows that came out as not a number, where it cannot be undefined.

    Raises:
        UserError: naming the metric, the horizon and the window.
    """
    for name, values in found.items():
        metric = metrics.get(name)
        defined = isinstance(metric, HorizonMetric) and not metric.skip_undefined
        if not isinstance(values, PerHorizon) or not (defined or name in ERRORS):
            continue
        none = values.per_window.isnan()
        lost = torch.nonzero(none)
        if len(lost) and (name in ERRORS or not bool(none.all())):  # what needs samples is undefined without any
            window, horizon = (int(k) for k in lost[0])
            raise UserError(
                f"the metric {name} is not a number {horizon + 1} frames ahead in window {int(values.index[window])}; "
                "check the store by `envpred verify`, and the metric if it is your own"
            )
