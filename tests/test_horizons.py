"""Steps and names of horizons at several frame rates."""

import doctest

import pytest
from hypothesis import given
from hypothesis import strategies as st

from envpred import horizons
from envpred.horizons import SHOWN_S, horizon_name, in_seconds, shown_steps


@pytest.mark.parametrize(
    ("period", "reach", "steps"),
    [
        (0.1, 15, (1, 5, 10, 15)),
        (0.1, 9, (1, 5)),
        (0.1, 40, (1, 5, 10, 15)),
        (0.05, 30, (2, 10, 20, 30)),
        (0.05, 1, (1,)),  # 0.05 s: none of those shown, so the last
        (0.2, 7, (5,)),  # of 0.1, 0.5, 1.0, 1.5 s only 1.0 s ends a step
        (0.0667, 23, (15,)),  # 15 Hz, rounded
        (0.4, 3, (3,)),
    ],
)
def test_steps_that_are_shown(period: float, reach: int, steps: tuple[int, ...]) -> None:
    assert shown_steps(reach, period) == steps


@given(st.integers(1, 60), st.sampled_from([0.01, 0.02, 0.025, 0.04, 0.05, 0.1, 1 / 15, 0.2, 0.5]))
def test_steps_are_in_reach_and_in_order(reach: int, period: float) -> None:
    steps = shown_steps(reach, period)
    assert list(steps) == sorted(set(steps))
    assert 1 <= steps[0] <= steps[-1] <= reach
    if reach * period > 1.51:  # of all these periods 1 s or 1.5 s is a multiple
        assert all(min(abs(n * period - s) for s in SHOWN_S) < 0.02 for n in steps)


def test_names() -> None:
    assert [horizon_name(steps) for steps in (1, 5, 10, 15, 40)] == ["0.1s", "0.5s", "1.0s", "1.5s", "4.0s"]
    assert [horizon_name(steps, 0.05) for steps in (1, 2, 3)] == ["0.05s", "0.1s", "0.15s"]
    assert [in_seconds(seconds) for seconds in (0.0, 0.30000000000000004, 0.025, 1 / 15)] == [
        *("0.0 s", "0.3 s", "0.025 s", "0.067 s"),
    ]


def test_examples_in_docstrings() -> None:
    assert doctest.testmod(horizons).failed == 0
