"""Forecasts on the disk, and the grids that they were made from, where they lie in the world."""

import numpy as np
import torch

from envpred.live.occupancy_grid import OccupancyGrid, occupancy_grid
from envpred.live.placed import LEAST, Grids, PlacedForecast, within
from envpred.mapping.ego_motion import EgoMotion, ego_futures, extrapolate
from envpred.mapping.evidence import pignistic
from envpred.mapping.geometry import FloatArray, heading_of
from envpred.results.predictions import Predictions
from envpred.store import Store, StoredDrive

# Roles of methods that take the ego to go on at constant speed and turn rate; others, to where it is likeliest.
STRAIGHT_ON = ("moved", "particle")


def placed_window(predictions: Predictions, k: int, store: Store) -> PlacedForecast:
    """Window `k` of `predictions` in the world.

    Raises:
        UserError: if the store holds other grids than those forecast from, or the forecast cannot be read.
    """
    window = predictions.windows[k]
    (forecast,) = predictions.scene(k, store).forecasts.values()
    drive, given = store.drives[window["drive"]], len(window["frames"])
    cut = slice(window["start"], window["start"] + given)
    poses, times = np.array(drive.array("pose")[cut], np.float64), np.array(drive.array("time")[cut], np.float64)
    pose = np.concatenate([drive.grid.in_cells(poses[:, :3, 3], drive.origin), heading_of(poses)[:, None]], axis=1)
    ego = _ego(predictions.manifest["role"], pose, times, len(forecast), drive.grid.resolution)
    mass, sensor = known_mass(drive, cut.stop - 1), drive.sensor_to_body
    return PlacedForecast(
        forecast,
        ego,
        pignistic(mass),
        mass.sum(axis=0) >= LEAST,
        pose[-1],
        (float(sensor[0, 3]), float(sensor[1, 3]), float(heading_of(sensor))),
        (drive.body.rear, drive.body.front, drive.body.half_width),
        (float(drive.origin[0]), float(drive.origin[1])),
        drive.grid.resolution,
        drive.period,
        float(times[-1]),
    )


def now_grid(drive: StoredDrive, t: int) -> OccupancyGrid:
    """What is known after the frame at position `t`: percent occupied, -1 where nothing is known of a cell."""
    mass, time = known_mass(drive, t), float(drive.array("time")[t])
    probability = np.where(mass.sum(axis=0) >= LEAST, pignistic(mass), np.float32(np.nan))
    first = np.array(drive.array("centre_cell")[t]) - probability.shape[0] // 2
    origin = float(drive.origin[0]), float(drive.origin[1])
    return occupancy_grid(probability, first, origin, drive.grid.resolution, time, time)


def known_mass(drive: StoredDrive, t: int) -> Grids:
    """Evidence (2, H', W') after the frame at position `t`; on the wider grid where the drive has one."""
    wide = None if drive.context is None else np.array(drive.array("context_evidence")[t], np.float32)
    return within(np.array(drive.array("evidence")[t], np.float32), wide)


def _ego(role: str, pose: FloatArray, times: FloatArray, horizons: int, resolution: float) -> FloatArray:
    """Where (horizons, 3) a method of that role takes the ego to go after `pose` (given, 3)."""
    if role in STRAIGHT_ON:
        return np.asarray(extrapolate(torch.from_numpy(pose)[None], horizons)[0], np.float64)
    (ego,) = ego_futures(pose, times, horizons, 1, np.random.default_rng(0), EgoMotion(), resolution)
    likeliest: FloatArray = ego
    return likeliest
