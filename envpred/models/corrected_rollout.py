"""The rollout with a small network in it or on top, which starts as the rollout and learns what that gets wrong."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from envpred.datamodules import Forecast, Role, Seen, WindowBatch
from envpred.errors import UserError
from envpred.mapping.geometry import FREE, OCCUPIED, FloatArray
from envpred.mapping.rollout import Scene
from envpred.mapping.shift import shifted
from envpred.models.parts import Parts
from envpred.models.rollout import RolloutForecaster, Window, threads
from envpred.models.samples import recentred
from envpred.networks.correction import FACTOR, LEAST, Canvas, Correction, WorldCorrection
from envpred.networks.muon import Muon

# Where the ego stands little changes, static is hard to beat, and there are few such drives to learn from: half of the
# correction counts there.
TRUST_STANDING = 0.5
MARGIN = 8  # cells of the canvas around the future grids


class CorrectedRolloutForecaster(RolloutForecaster):
    """The rollout, corrected by a small network that looks at all that was seen.

    Trained by squared errors, as a share of the static baseline's of the same window where `error` says so: windows in
    which little happens count as much as others.

    Args:
        variant: input variant; the forecast is made of labels and evidence whatever it is.
        given: frames shown.
        horizons: forecasts at most.
        width: channels of the network at half of the resolution.
        fine: channels at full resolution.
        head: channels for each cell and horizon.
        futures: of the ego that the rollout averages over.
        world: what the rays meet, see `RolloutForecaster`.
        movers: carry on what moves, likewise.
        corrects: the `world` before it is rendered, so that the network learns through the rays, or the `forecast` that
            was rendered (see `WorldCorrection` and `Correction`).
        seed: of the futures.
        scored: horizons of a training window that count, drawn at random; of corrected forecasts fewer are faster.
        error: squared errors as they are, or their share of the static baseline's.
        lr: learning rate of Muon.
        max_epochs: epochs of training; the learning rate falls to 0 by their end.
        samples: draw the rollout's samples beside their mean, moved to the corrected one.
        init_from: weights that training starts from: name of those that ship, or checkpoint.
    """

    role: ClassVar[Role] = "learned"
    shaping = ("variant", "given", "horizons", "width", "fine", "head", "corrects")

    def __init__(
        self,
        variant: str = "dst_static",
        given: int = 5,
        horizons: int = 15,
        width: int = 32,
        fine: int = 16,
        head: int = 16,
        futures: int = 16,
        world: Literal["label", "hits"] = "hits",
        movers: bool = False,
        corrects: Literal["forecast", "world"] = "world",
        seed: int = 0,
        scored: int = 6,
        error: Literal["squared", "share"] = "share",
        lr: float = 0.07,
        max_epochs: int = 8,
        samples: bool = False,
        init_from: str | None = None,
    ) -> None:
        super().__init__(variant, given, futures, world, context=True, movers=movers, samples=samples, seed=seed)
        self.save_hyperparameters()
        if width % 8 or width < 8:
            raise UserError(f"--model.width {width}: give a multiple of 8")
        made = Correction if corrects == "forecast" else WorldCorrection
        self.network = made(given, horizons, width, fine, head)

    @property
    def epochs(self) -> int:
        return int(self.hparams["max_epochs"])

    @property
    def reachable(self) -> int:
        return int(self.hparams["horizons"])

    def forecast(self, seen: Seen, horizons: int) -> Forecast:
        if self.hparams["corrects"] == "world":
            return super().forecast(seen, horizons)
        probability = self._corrected(seen, horizons, torch.arange(horizons), TRUST_STANDING)
        drawn = super().forecast(seen, horizons).samples if self.hparams["samples"] else None
        return Forecast(probability, samples=None if drawn is None else recentred(drawn, probability))

    def parts(self, seen: Seen, horizons: int) -> Parts:
        return super().parts(seen, horizons)._replace(corrected=self.forecast(seen, horizons).probability)

    def _believed(self, scene: Scene, window: Window) -> Scene:
        if self.hparams["corrects"] != "world":
            return scene
        with torch.no_grad():
            hit = self._corrected_hit(window, scene, TRUST_STANDING)
        return scene._replace(world=replace(scene.world, hit=hit.cpu().numpy()))

    def _corrected(self, seen: Seen, horizons: int, which: Tensor, standing: float = 1.0) -> Tensor:
        """Probabilities (B, len(which), H, W) at the horizons `which` (0 is the first) of `horizons` rolled out."""
        windows = [self._window(seen, b) for b in range(len(seen["pose"]))]
        return torch.stack([self._correct(window, horizons, which, standing) for window in windows])

    def _correct(self, window: Window, horizons: int, which: Tensor, standing: float) -> Tensor:
        """The forecast of one window; `standing` is the share of the correction that counts while the ego stands."""
        futures = self.ego(window, horizons)
        scene, _ = self._scene(window, futures)
        if self.hparams["corrects"] == "world":
            return self._render(window, scene, self._corrected_hit(window, scene, standing))[which]
        trust, mean = _trust(window, futures[:, which], standing), futures.mean(axis=0)[which, :2]
        offset = self.offset(window)
        rendered = self._sensor(window).rendered(scene, threads().map, offset)[which]
        # Where the grid of the mean future lies, beside that of the last frame shown.
        centres = np.floor(mean + 0.5).astype(np.int64) + offset - np.asarray(window["centre_cell"][-1], np.int64)
        n, cells = rendered.shape[-1], int(window["context_label"].shape[-1])
        first = centres + (cells - n) // 2
        canvas, corner = self._canvas(window, *_extent(first, n, cells))
        spread = torch.from_numpy(0.5 * futures[:, which, :2].std(axis=0)).float()
        device = self.device
        corrected: Tensor = self.network(
            Canvas(*(part.to(device) for part in canvas)),
            torch.from_numpy(rendered).to(device),
            (first - corner).tolist(),
            spread.to(device),
            which.to(device),
        ).float()
        rolled = torch.from_numpy(0.5 + 0.5 * (rendered[:, 0] - rendered[:, 1])).to(device)
        return corrected.lerp(rolled, 1 - trust) if trust < 1 else corrected

    def _corrected_hit(self, window: Window, scene: Scene, standing: float) -> Tensor:
        """Probabilities of a hit (N, I, J) in the part of the context that the scene's world is."""
        world, futures = scene.world, scene.futures
        low = np.array(world.first)
        canvas, corner = self._canvas(window, low, low + np.array(world.hit.shape[1:]))
        hit = torch.from_numpy(world.hit).expand(futures.shape[1], -1, -1).to(self.device)
        i, j = (low - corner).tolist()
        trust = _trust(window, futures, standing)
        corrected: Tensor = self.network(canvas.channels.to(self.device), hit, (i, j), trust).float()
        return corrected

    def _render(self, window: Window, scene: Scene, hit: Tensor) -> Tensor:
        """The forecast (N, H, W) of a world of these hits, through which gradients go."""
        sensor, offset = self._sensor(window), self.offset(window)

        def render(hit: NDArray[np.float32]) -> NDArray[np.float32]:
            return sensor.expected(scene._replace(world=replace(scene.world, hit=hit)), threads().map, offset)

        def back(by: NDArray[np.float32], hit: NDArray[np.float32]) -> NDArray[np.float32]:
            corrected = scene._replace(world=replace(scene.world, hit=hit))
            return sensor.gradient(by[:, None], corrected, threads().map, offset)

        rendered: Tensor = Rendering.apply(hit, render, back)  # type: ignore[no-untyped-call]
        return rendered

    def _canvas(
        self, window: Window, low: NDArray[np.int64], high: NDArray[np.int64]
    ) -> tuple[Canvas, NDArray[np.int64]]:
        """What was seen from cell `low` of the context to `high`, or a little more, as far as it is known.

        Returns:
            the canvas, whose sides FACTOR divides, and its first cell in the context.
        """
        label, mass = self._context(window)
        cells, n = label.shape[-1], window["label"].shape[-1]
        centre, margin = np.asarray(window["centre_cell"], np.int64), (cells - n) // 2
        low, high = _divided(low, high, cells)
        part = (..., slice(low[0], high[0]), slice(low[1], high[1]))
        labels = np.stack([shifted(grid, centre[-1] - at)[part] for grid, at in zip(label, centre, strict=True)])
        judged = np.zeros((3, cells, cells), np.float32)
        inside = slice(margin, margin + n)
        judged[:2, inside, inside], judged[2, inside, inside] = window["evidence"][-1], 1
        judged = judged[part]
        last = _logit(0.5 + 0.5 * (judged[0] - judged[1])) / 4 * judged[2]
        rows = [*(labels == OCCUPIED), *(labels == FREE), *mass[part], *judged, self._range(window, low, high), last]
        channels = torch.from_numpy(np.stack([np.asarray(row, np.float32) for row in rows]))
        return Canvas(channels, channels[2 * len(label) + 4], channels[-1]), low

    def _range(self, window: Window, low: NDArray[np.int64], high: NDArray[np.int64]) -> FloatArray:
        """Logarithm of the distance to the sensor at the last frame shown, from cell `low` of the context to `high`."""
        x, y, heading = (float(value) for value in window["pose"][-1])
        ahead, left, _ = (float(value) / float(window["resolution"]) for value in window["sensor"])
        cos, sin = np.cos(heading), np.sin(heading)
        first = np.asarray(window["centre_cell"][-1], np.int64) - window["context_label"].shape[-1] // 2
        i = np.arange(low[0], high[0])[:, None] + first[0] - x - ahead * cos + left * sin
        j = np.arange(low[1], high[1])[None] + first[1] - y - ahead * sin - left * cos
        return np.asarray(np.log1p(np.hypot(i, j) / 10) - 1.5)

    def training_step(self, batch: WindowBatch, batch_index: int) -> Tensor:
        assert batch["future"] is not None
        seen, target = batch["seen"], batch["future"]["occupancy"]
        horizons = target.shape[1]
        which = torch.randperm(horizons)[: min(horizons, int(self.hparams["scored"]))].sort().values
        target = target[:, which]
        error = (self._corrected(seen, horizons, which) - target).square().mean((2, 3))
        if self.hparams["error"] == "share":
            static = (seen["occupancy"][:, -1:] - target).square().mean((2, 3))
            error = 0.1 * error / (static + 0.01)  # 0.01: where nothing happens there is nothing to win
        self.log("train/loss", error.mean(), prog_bar=True, batch_size=len(target))
        return error.mean()

    def configure_optimizers(self) -> Any:
        plain = ("leave", "project", "spread")
        matrices = [p for n, p in self.network.named_parameters() if p.dim() > 1 and not n.startswith(plain)]
        others = [p for p in self.network.parameters() if not any(p is matrix for matrix in matrices)]
        lr = float(self.hparams["lr"])
        optimizer = Muon(matrices, others, lr, 0.1 * lr)
        steps = max(1, int(self.trainer.estimated_stepping_batches))
        schedule = torch.optim.lr_scheduler.LambdaLR(
            optimizer, lambda k: min(1.0, (k + 1) / 50) * 0.5 * (1 + float(np.cos(np.pi * min(k / steps, 1.0))))
        )
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}


def _trust(window: Window, futures: FloatArray, standing: float) -> float:
    """How much of a correction counts: all where the ego moves on, the share `standing` where it stands."""
    away = futures.mean(axis=0)[:, :2] - np.asarray(window["pose"][-1], np.float64)[:2]
    moved = float(np.hypot(*away.T).max(initial=0))
    return 1 - (1 - standing) * min(max(1.5 - moved, 0.0), 1.0)  # cells; who moves by half a cell still stands


def _extent(first: NDArray[np.int64], n: int, cells: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """From where to where (2,) the future grids, whose first cells are `first`, and the last one reach, and MARGIN."""
    last = (cells - n) // 2
    return np.minimum(first.min(axis=0), last) - MARGIN, np.maximum(first.max(axis=0), last) + n + MARGIN


def _divided(
    low: NDArray[np.int64], high: NDArray[np.int64], cells: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The part from `low` to `high` as far as the context goes, made larger so that FACTOR divides its sides."""
    low, high = np.clip(low, 0, cells), np.clip(high, 0, cells)
    side = np.minimum(-(-(high - low) // FACTOR) * FACTOR, cells // FACTOR * FACTOR)
    low = np.clip(low - (side - (high - low)) // 2, 0, cells - side)
    return low, low + side


class Rendering(torch.autograd.Function):
    """A world that is measured: `render` makes the forecast (N, H, W) of its hits, `back` their gradient of that."""

    @staticmethod
    def forward(
        ctx: Any,
        hit: Tensor,
        render: Callable[[NDArray[np.float32]], NDArray[np.float32]],
        back: Callable[[NDArray[np.float32], NDArray[np.float32]], NDArray[np.float32]],
    ) -> Tensor:
        """The forecast of hits (N, I, J)."""
        ctx.back = back
        ctx.save_for_backward(hit)
        return torch.from_numpy(render(hit.detach().cpu().numpy())).to(hit.device)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None, None]:
        """The gradient (N, I, J) by the hits."""
        (hit,) = ctx.saved_tensors
        by, device = np.ascontiguousarray(gradients[0].cpu().numpy(), np.float32), hit.device
        return torch.from_numpy(np.ascontiguousarray(ctx.back(by, hit.cpu().numpy()))).to(device), None, None


def _logit(probability: NDArray[np.float32]) -> NDArray[np.float32]:
    kept = np.clip(probability, LEAST, 1 - LEAST)
    return np.asarray(np.log(kept / (1 - kept)), np.float32)
