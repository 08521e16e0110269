"""Where the ego stands, hits come and go and the last frame is hard to beat: the rollout is no worse at any horizon."""

import numpy as np
import pytest

from envpred.mapping import hit_rates
from envpred.mapping.ego_motion import EgoMotion, ego_futures
from envpred.mapping.evidence import accumulate, pignistic
from envpred.mapping.geometry import FloatArray, GridSpec
from envpred.mapping.label_grid import RayCasting
from envpred.mapping.rollout import Rollout, Scene
from envpred.mapping.world import label_world

JUDGED, CONTEXT = GridSpec(64), GridSpec(128)
GIVEN, HORIZONS = 5, 15


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_nothing_is_worse_than_the_last_frame_where_the_ego_stands(seed: int) -> None:
    """Walls and posts whose points are missed by chance, those far off more often, and wander by centimetres."""
    random = np.random.default_rng(seed)
    frames = 4 * (GIVEN + HORIZONS)
    starts, ends = random.uniform(-20, 20, (2, 30, 2))
    ends = starts + (ends - starts) * 0.2
    along = np.linspace(0, 1, 60)[:, None]
    places = np.concatenate([a + along * (b - a) for a, b in zip(starts, ends, strict=True)])
    places = places[np.abs(places).max(axis=1) > 4]
    missed = np.clip(0.05 + np.linalg.norm(places, axis=1) / 25, 0, 0.95)
    poses = np.tile([0.2, -0.3, 0.4], (frames, 1)) + random.normal(0, 0.002, (frames, 3))
    centre, origin, sensor = np.zeros(2, np.int32), np.zeros(2), np.eye(4)
    turn = np.array([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]])
    sensor[:2, :2], sensor[:2, 3] = turn, np.array([0.2, -0.3]) * JUDGED.resolution
    labels = {}
    for spec in (JUDGED, CONTEXT):
        noise = np.random.default_rng(seed + 1)
        labels[spec] = np.empty((frames, spec.cells, spec.cells), np.uint8)
        for t in range(frames):
            points = np.zeros((len(places), 4), np.float32)
            points[:, :2] = (places + noise.normal(0, 0.04, places.shape) - sensor[:2, 3]) @ turn
            points = points[noise.random(len(points)) > missed]
            every = np.ones(len(points), np.bool_)
            labels[spec][t] = RayCasting().label(points, every, sensor, centre, origin, spec)
    centres = np.zeros((frames, 2), np.int32)
    masses = {spec: accumulate(labels[spec], centres) for spec in labels}
    probability = pignistic(masses[JUDGED])
    rollout = Rollout((0.0, 0.0), grid=JUDGED)
    errors: dict[str, list[FloatArray]] = {"rollout": [], "static": [], "label": []}
    for start in range(0, frames - GIVEN - HORIZONS + 1, GIVEN + HORIZONS):
        last = start + GIVEN - 1
        seen = slice(start, last + 1)
        times = 0.1 * np.arange(GIVEN, dtype=np.float64)
        futures = ego_futures(poses[seen], times, HORIZONS, 16, random, EgoMotion(), JUDGED.resolution)
        shown = labels[CONTEXT][seen], centres[seen], masses[CONTEXT][last]
        world = hit_rates.default().world(*shown, futures, poses[last], JUDGED.resolution, JUDGED.cells)
        forecast = rollout.expected(Scene(masses[JUDGED][last], world, centre, futures))
        alone = rollout.expected(Scene(masses[JUDGED][last], label_world(labels[CONTEXT][last]), centre, futures))
        target = probability[last + 1 : last + 1 + HORIZONS]
        for name, found in (("rollout", forecast), ("static", probability[last]), ("label", alone)):
            errors[name].append(((found - target) ** 2).mean(axis=(1, 2)))
    ours, static, label = (np.mean(errors[name], axis=0) for name in ("rollout", "static", "label"))
    assert (ours <= static).all(), np.round(ours / static, 3)
    assert (label > static).any(), "a drive on which it takes more than the last label"
