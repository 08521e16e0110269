"""The future measured again: the world as it was seen, scanned from where the ego will be, without anything learned."""

import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from typing import ClassVar, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from envpred.datamodules import Forecast, Needs, Role, Seen
from envpred.errors import UserError
from envpred.mapping import hit_rates
from envpred.mapping.ego_motion import EgoMotion, cell_weights, cells_of, centre_offset, ego_futures
from envpred.mapping.evidence import PAPER
from envpred.mapping.geometry import FloatArray, GridSpec
from envpred.mapping.movers import Movers, Moving
from envpred.mapping.rollout import Rollout, Scene
from envpred.mapping.world import World, label_world
from envpred.models.forecaster import Forecaster
from envpred.models.parts import Parts, hide_unseen, whole_world

Window = Mapping[str, NDArray[np.generic]]  # what is seen of one window, as arrays
MANY, SOON = 512, 4  # futures that tell how likely each cell is, and the frames ahead for which they do


def threads() -> ThreadPoolExecutor:
    """As many threads as torch takes, for the rays.  They are kept: to start them anew takes a millisecond or two."""
    return _threads(max(1, torch.get_num_threads()), os.getpid())


@cache
def _threads(count: int, process: int) -> ThreadPoolExecutor:
    """So many threads of this process: none goes on in a fork."""
    return ThreadPoolExecutor(count)


class RolloutForecaster(Forecaster):
    """Casts the sensor's rays from where the ego will be into the world as it was seen, and fuses what they meet.

    The forecast is the expected evidence over a number of ego futures: constant turn rate and acceleration, with errors
    (see `envpred.mapping.rollout` and `envpred.mapping.ego_motion`).

    Args:
        variant: input variant; the forecast is made of labels and evidence whatever it is.
        given: frames shown.
        futures: of the ego that are averaged over; 1 is the likeliest alone.
        world: what rays meet: the occupied cells of the last `label` grid, or `hits` as often as the frames shown say.
        context: look beyond the judged grid.
        movers: carry on what moves by its velocity; needs velocities relative to the ground.
        samples: draw single futures beside their mean.
        seed: of the futures.

    Attributes:
        rates: how often cells are hit, for the world `hits`; those of the package, until others are put there.
        motion: the spread of the ego's futures, likewise.  Neither goes into a checkpoint.
    """

    role: ClassVar[Role] = "rollout"

    def __init__(
        self,
        variant: str = "dst_static",
        given: int = 5,
        futures: int = 16,
        world: Literal["label", "hits"] = "hits",
        context: bool = True,
        movers: bool = False,
        samples: bool = False,
        seed: int = 0,
    ) -> None:
        super().__init__(variant, given)
        self.save_hyperparameters()
        if futures < 1:
            raise UserError(f"--model.futures {futures}: give at least 1")
        self.rates, self.motion = hit_rates.default(), EgoMotion()
        arrays = ["evidence", *(["context_evidence"] if context else [])]
        arrays += ["velocity", "velocity_cov"] if movers else []
        self.needs = Needs(tuple(arrays), context, self.needs.future_pose)

    def setup(self, stage: str) -> None:
        super().setup(stage)
        if self.hparams["movers"] and self.dataset.velocity_frame() != "ground":
            raise UserError(
                f"{self.dataset.store}: its velocities are relative to the ego, movers need those relative to the "
                "ground; build a store with `envpred grids --config ground_velocity`, or give "
                "--model.movers false"
            )

    def forecast(self, seen: Seen, horizons: int) -> Forecast:
        windows = [self._window(seen, b) for b in range(len(seen["pose"]))]
        found = [self._rolled(window, self.ego(window, horizons)) for window in windows]
        device = seen["pose"].device
        probability = torch.from_numpy(np.stack([mean for mean, _ in found])).to(device)
        drawn = [samples for _, samples in found if samples is not None]
        return Forecast(probability, samples=torch.from_numpy(np.stack(drawn)).to(device) if drawn else None)

    def parts(self, seen: Seen, horizons: int) -> Parts:
        """What the forecast is made of."""
        worlds, rendered = [], []
        for window in (self._window(seen, b) for b in range(len(seen["pose"]))):
            futures, offset = self.ego(window, horizons), self.offset(window)
            scene, _ = self._scene(window, futures)
            rendered.append(self._sensor(window).expected(scene, threads().map, offset))
            scene = self._believed(scene, window)
            centre, half = np.asarray(scene.centre_cell, np.int64), scene.mass.shape[-1] // 2
            times = horizons, float(window["period"]), float(window["resolution"])
            worlds.append(whole_world(scene.world, scene.movers, centre, times))
            places = cells_of(futures) + offset - centre + scene.world.cells // 2
            hide_unseen(worlds[-1], places.min(axis=0) - half, places.max(axis=0) + half)
        device = seen["pose"].device
        return Parts(*(torch.from_numpy(np.stack(grids)).to(device) for grids in (worlds, rendered)))

    def ego(self, window: Window, horizons: int) -> FloatArray:
        """Futures (K, horizons, 3) of the ego: x and y in cells of the lattice, heading in radians."""
        return self._drawn(window, horizons, self.hparams["futures"], np.random.default_rng(self.hparams["seed"]))

    def futures(self, seen: Seen, horizons: int) -> Tensor:
        """The egos (B, K, horizons, 3) that the samples of a forecast go with, as `ego`."""
        windows = [self._window(seen, b) for b in range(len(seen["pose"]))]
        return torch.from_numpy(np.stack([self.ego(window, horizons) for window in windows]))

    def weights(self, window: Window, futures: FloatArray) -> FloatArray | None:
        """Weights (K, N) of the `futures`, see `ego_motion.cell_weights`; None if all count alike."""
        if len(futures) == 1:
            return None
        many = self._drawn(window, SOON, MANY, np.random.default_rng([self.hparams["seed"], 2]))
        return cell_weights(futures, many)

    def _drawn(self, window: Window, horizons: int, count: int, generator: np.random.Generator) -> FloatArray:
        """So many futures (count, horizons, 3) of the ego."""
        poses, times = np.asarray(window["pose"], np.float64), np.asarray(window["time"], np.float64)
        return ego_futures(poses, times, horizons, count, generator, self.motion, float(window["resolution"]))

    def _rolled(self, window: Window, futures: FloatArray) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
        """The forecast (N, H, W) of one window, and its samples (K, N, H, W) where they are asked for."""
        rollout, (scene, generator) = self._sensor(window), self._scene(window, futures)
        scene = self._believed(scene, window)
        offset = self.offset(window)
        mean = rollout.expected(scene, threads().map, offset)
        return mean, rollout.samples(scene, generator, threads().map, offset) if self.hparams["samples"] else None

    def offset(self, window: Window) -> tuple[int, int]:
        """Centre cells of grids less the cells that hold the ego: 0, but for windows that are turned or cut out."""
        centre_cells, poses = np.asarray(window["centre_cell"], np.int64), np.asarray(window["pose"], np.float64)
        east, north = centre_offset(centre_cells, poses).tolist()
        return east, north

    def _sensor(self, window: Window) -> Rollout:
        """The sensor and the mapping that the future is measured with."""
        east, north, heading = (float(value) for value in window["sensor"])
        rear, front, half_width = (float(value) for value in window["body"])
        period, cells = float(window["period"]), window["label"].shape[-1]
        return Rollout(
            sensor=(east, north),
            sensor_heading=heading,
            grid=GridSpec(cells, float(window["resolution"])),
            body=(rear, front, half_width),
            evidence=PAPER.at(period),
            period=period,
            beyond=0.0,  # what lies beyond the context is not known, and most of the world is free
        )

    def _scene(self, window: Window, futures: FloatArray) -> tuple[Scene, np.random.Generator]:
        """What a rollout takes, but for how it is run, and the source of further randomness."""
        world, movers = self._world(window, futures)
        # A stream of its own, so that what moves does not change where the ego goes.
        generator = np.random.default_rng([self.hparams["seed"], 1])
        draws = generator.standard_normal((len(futures), 2)) if movers is not None else None
        mass, centre = np.asarray(window["evidence"][-1], np.float32), np.asarray(window["centre_cell"][-1], np.int64)
        return Scene(mass, world, centre, futures, movers, draws, self.weights(window, futures)), generator

    def _believed(self, scene: Scene, window: Window) -> Scene:
        """The scene that forecasts are made of: what was seen, unless somebody has learned more."""
        return scene

    def _world(self, window: Window, futures: FloatArray) -> tuple[World, Movers | None]:
        """What the rays meet on the context grid: what stands, and what moves if that is told apart."""
        label, mass = self._context(window)
        centre_cells, judged = np.asarray(window["centre_cell"], np.int64), np.asarray(window["label"][-1], np.uint8)
        if self.hparams["world"] == "label":
            world = label_world(label[-1])
        else:
            # The rates go by where grids lie, which an offset moves as if the ego were there.
            moved = np.array([*self.offset(window), 0])
            last, cells = np.asarray(window["pose"][-1], np.float64) + moved, judged.shape[-1]
            resolution, period = float(window["resolution"]), float(window["period"])
            world = self.rates.world(label, centre_cells, mass, futures + moved, last, resolution, cells, period)
            world = replace(world, place=(world.place[0] - moved[0], world.place[1] - moved[1]))
        if not self.hparams["movers"]:
            return world, None
        velocity, covariance = (np.asarray(window[name][-1], np.float32) for name in ("velocity", "velocity_cov"))
        return Moving().split(world, judged, velocity, covariance, centre_cells[-1], futures.shape[1], "ground")

    def _context(self, window: Window) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Labels (T, W, W) and last masses (2, W, W) of all that is known; the judged grid's where there is one."""
        judged, mass = np.asarray(window["label"], np.uint8), np.asarray(window["evidence"][-1], np.float32)
        if not self.needs.context:
            return judged, mass
        label, wide = np.array(window["context_label"], np.uint8), np.array(window["context_evidence"][-1], np.float32)
        margin = (label.shape[-1] - judged.shape[-1]) // 2
        inside = (..., slice(margin, margin + judged.shape[-1]), slice(margin, margin + judged.shape[-1]))
        label[inside], wide[inside] = judged, mass
        return label, wide

    def _window(self, seen: Seen, b: int) -> Window:
        """Window `b` of what is seen, as arrays."""
        names = (
            "pose",
            "time",
            "centre_cell",
            "label",
            "sensor",
            "body",
            "resolution",
            "period",
            "context_label",
            "future_pose",
        )
        fields: dict[str, Tensor] = {name: seen[name] for name in names if name in seen}  # type: ignore[literal-required]
        fields |= seen["arrays"]
        return {name: field[b].cpu().numpy() for name, field in fields.items()}


class RolloutOracle(RolloutForecaster):
    """The rollout from where the ego truly was: what a perfect plan would be worth."""

    role: ClassVar[Role] = "oracle"
    needs = Needs(future_pose=True)

    def ego(self, window: Window, horizons: int) -> FloatArray:
        return np.asarray(window["future_pose"], np.float64)[None, :horizons]
