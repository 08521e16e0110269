"""What a rollout renders beside the forecast, and how its futures are weighed."""

import numpy as np

from envpred.mapping.geometry import GridSpec
from envpred.mapping.rollout import Rollout, Scene
from envpred.mapping.world import World
from tests.mapping.test_rollout import NOTHING, ORIGIN_CELL, hits, small, still


def test_what_is_rendered_is_what_the_forecast_is_made_of() -> None:
    """The masses' pignistic probability is the forecast, also where the ego stands and remembers."""
    generator = np.random.default_rng(4)
    cells, grid = 64, GridSpec(32)
    mass = generator.dirichlet((1, 1, 1), size=(32, 32)).transpose(2, 0, 1)[:2].astype(np.float32)
    hit = np.where(generator.random((cells, cells)) < 0.2, generator.random((cells, cells)), 0).astype(np.float32)
    rollout = Rollout((0.5, -0.2), grid=grid)
    standing = np.tile([100.0, 100.0, 0.3], (3, 4, 1))
    moving = standing + np.stack([np.arange(1.0, 5), np.zeros(4), np.zeros(4)], axis=1)
    for futures in (standing, moving):
        rendered = rollout.rendered(Scene(mass, World(hit[None]), np.array([100, 100]), futures))
        forecast = rollout.expected(Scene(mass, World(hit[None]), np.array([100, 100]), futures))
        np.testing.assert_allclose(0.5 + 0.5 * (rendered[:, 0] - rendered[:, 1]), forecast, atol=1e-5)
        assert rendered.shape == (4, 4, 32, 32)
        assert rendered.min() > -1e-6
        assert (rendered[:, 0] + rendered[:, 1]).max() < 1 + 1e-5
        assert (rendered[:, 2] + rendered[:, 3]).max() < 1 + 1e-5


def test_weights_are_those_of_the_futures_at_each_horizon() -> None:
    """Two futures, one of which counts three quarters at the first horizon and all at the second."""
    futures = np.stack([still(2)[0], still(2, x=1.0)[0]])
    weights = np.array([[0.75, 1.0], [0.25, 0.0]])
    wall = hits({(4, j): 1.0 for j in range(-3, 4)}, 32)
    each = [small().expected(Scene(NOTHING, wall, ORIGIN_CELL, futures[[k]])) for k in (0, 1)]
    found = small().expected(Scene(NOTHING, wall, ORIGIN_CELL, futures, weights=weights))
    np.testing.assert_allclose(found[0], 0.75 * each[0][0] + 0.25 * each[1][0], atol=1e-6)
    np.testing.assert_allclose(found[1], each[0][1], atol=1e-6)
    # Futures that are alike are rolled once, for what they weigh together.
    twice = Scene(
        NOTHING, wall, ORIGIN_CELL, futures[[0, 1, 0]], weights=np.array([[0.5, 0.6], [0.25, 0.0], [0.25, 0.4]])
    )
    np.testing.assert_allclose(small().expected(twice), found, atol=1e-6)
