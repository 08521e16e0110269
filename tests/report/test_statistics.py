"""Paired comparisons."""

import math

import numpy as np
import pytest

from envpred.report.statistics import bootstrap_interval, compare_pairs, holm, wilcoxon


def test_wilcoxon_by_hand() -> None:
    # Of the 2^5 sign patterns of ranks 1..5 one has rank sum 0 and one 15: p = 2/32.
    assert wilcoxon(np.array([1.0, 2, 3, 4, 5])) == pytest.approx(2 / 32)
    # Rank sum 1 of the negatives is met or passed by {}, {1} and their mirror images: p = 4/32.
    assert wilcoxon(np.array([-1.0, 2, 3, 4, 5])) == pytest.approx(4 / 32)
    # Zeros drop out.
    assert wilcoxon(np.array([0.0, 1, 2, 3, 4, 5, 0])) == pytest.approx(2 / 32)
    assert wilcoxon(np.zeros(4)) == 1
    assert wilcoxon(np.empty(0)) == 1


def test_holm_by_hand() -> None:
    # Sorted .005 x 4, .01 x 3, .03 x 2, then .04 may not fall below its predecessor.
    np.testing.assert_allclose(holm(np.array([0.01, 0.04, 0.03, 0.005])), [0.03, 0.06, 0.06, 0.02])
    np.testing.assert_allclose(holm(np.array([0.6, 0.7])), [1.0, 1.0])
    assert len(holm(np.empty(0))) == 0


def test_bootstrap_is_the_normal_interval_of_many_windows() -> None:
    difference = np.random.default_rng(4).normal(0.3, 2.0, 2000)
    low, high = bootstrap_interval(difference, np.random.default_rng(0))
    half = 1.96 * difference.std(ddof=1) / math.sqrt(2000)
    assert (low, high) == pytest.approx((difference.mean() - half, difference.mean() + half), abs=half * 0.05)


def test_bootstrap_is_seeded_and_handles_few_windows() -> None:
    difference = np.array([0.1, 0.4, -0.2, 0.3])
    intervals = {bootstrap_interval(difference, np.random.default_rng(seed)) for seed in (1, 1, 2)}
    assert len(intervals) == 2
    assert bootstrap_interval(np.full(5, 0.2), np.random.default_rng(0)) == (0.2, 0.2)
    assert np.isnan(bootstrap_interval(np.array([0.2]), np.random.default_rng(0))).all()


def test_interval_covers_as_often_as_it_says() -> None:
    generator = np.random.default_rng(7)
    hits = 0
    for _ in range(300):
        low, high = bootstrap_interval(generator.exponential(1.0, 60), generator, level=0.9, resamples=400)
        hits += low < 1.0 < high
    assert 0.84 < hits / 300 < 0.95


def test_pairs() -> None:
    generator = np.random.default_rng(0)
    base = generator.random((40, 3))
    values = {
        "a": base,
        "b": base + 0.1 + 0.01 * generator.random((40, 3)),
        "c": base + generator.normal(0, 0.1, (40, 3)),
    }
    found = {(c.first, c.second, c.horizon): c for c in compare_pairs(values, [0, 2], seed=1)}
    assert set(found) == {(x, y, h) for x, y in (("a", "b"), ("a", "c"), ("b", "c")) for h in (0, 2)}
    clear = found["a", "b", 2]
    assert clear.difference == pytest.approx(-0.105, abs=0.002)
    assert clear.low < clear.difference < clear.high < -0.1
    assert clear.significant()
    # All 40 signs alike: p = 2 / 2^40; the smallest of the family of six, so six times as much.
    assert clear.p == pytest.approx(2 / 2**40)
    assert clear.p_holm == pytest.approx(6 * 2 / 2**40, rel=0.2)
    assert not found["a", "c", 0].significant()
    assert compare_pairs(values, [0, 2], seed=1) == list(found.values())


def test_undefined_windows_are_left_out() -> None:
    first = np.array([[1.0], [math.nan], [3.0], [4.0]])
    (only,) = compare_pairs({"a": first, "b": np.zeros((4, 1))}, [0])
    assert only.windows == 3
    assert only.difference == pytest.approx(8 / 3)


def test_other_windows_are_refused() -> None:
    with pytest.raises(ValueError, match="same windows for all, not a: 2, b: 3"):
        compare_pairs({"a": np.zeros((2, 1)), "b": np.zeros((3, 1))}, [0])
