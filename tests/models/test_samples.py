"""Samples moved to a corrected mean."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from envpred.models.samples import recentred


def test_by_hand() -> None:
    samples = torch.tensor([[0.0, 0.2], [0.4, 0.6], [0.5, 1.0]]).T.reshape(1, 2, 3, 1, 1)
    moved = recentred(samples, torch.tensor([0.05, 0.75, 0.75]).reshape(1, 3, 1, 1))
    # halved; half of the way to 1; as they were
    torch.testing.assert_close(moved[0, :, :, 0, 0].T, torch.tensor([[0.0, 0.1], [0.7, 0.8], [0.5, 1.0]]))
    surely = recentred(torch.tensor([0.0, 0.0, 1.0, 1.0]).reshape(1, 2, 2, 1, 1), torch.full((1, 2, 1, 1), 0.3))
    torch.testing.assert_close(surely.mean(1), torch.full((1, 2, 1, 1), 0.3))


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(0, 1, width=32), min_size=1, max_size=6), st.floats(0, 1, width=32))
def test_they_stay_probabilities_in_their_order_with_the_mean_asked_for(values: list[float], mean: float) -> None:
    samples = torch.tensor(values).reshape(1, -1, 1, 1, 1)
    moved = recentred(samples, torch.full((1, 1, 1, 1), mean))
    assert moved.min() >= 0
    assert moved.max() <= 1
    assert moved.mean().item() == pytest.approx(mean, abs=2e-5)
    order = samples.flatten().argsort()
    assert (moved.flatten()[order].diff() >= -1e-6).all()
