"""What a rollout renders beside the forecast: expected masses and measurements."""

import numpy as np

from envpred.mapping.geometry import GridSpec
from envpred.mapping.rollout import Rollout, Scene
from envpred.mapping.world import World


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
