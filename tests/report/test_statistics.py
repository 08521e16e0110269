"""Comparisons over drives."""

import math
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from envpred.report.statistics import (
    ENUMERATED,
    Contrast,
    by_drive,
    compare,
    drive_errors,
    interval,
    ratio_drive_errors,
    sign_tests,
)

AB = Contrast("a", "b", "?")


def names(windows: list[int]) -> list[str]:
    """The drive of each window, of drives with so many."""
    return [f"drive_{d}" for d, count in enumerate(windows) for _ in range(count)]


def lucky(generator: np.random.Generator, drives: int, windows: int, effect: float = 0.0) -> np.ndarray:
    """Differences (windows of all drives, 1), whose luck is shared within a drive: four fifths of the variance."""
    luck = generator.normal(0, 2, (drives, 1)) + generator.normal(0, 1, (drives, windows))
    return (luck + effect).reshape(-1, 1)


def test_standard_error_over_drives_by_hand() -> None:
    # Means 2 and 6 of two windows each: sums less the mean 4 are -4 and 4, sqrt(2/1 * 32) / 4 = 2.
    values = np.array([[1.0], [3.0], [5.0], [7.0]])
    np.testing.assert_allclose(drive_errors(values, names([2, 2])), [2.0])
    # The same windows, each of a drive of its own, are independent: the usual standard error.
    np.testing.assert_allclose(drive_errors(values, list("abcd")), values.std(ddof=1) / 2)
    assert np.isnan(drive_errors(values, list("aaaa"))).all()
    # An undefined window does not count, nor does a drive that has no other.
    np.testing.assert_allclose(drive_errors(np.append(values, [[math.nan]], axis=0), names([2, 2, 1])), [2.0])
    sums, counts = by_drive(values, ["b", "a", "b", "a"])
    assert sums.ravel().tolist() == [6, 10]
    assert counts.ravel().tolist() == [2, 2]
    with pytest.raises(ValueError, match="4 windows have 3 drives"):
        by_drive(values, list("abc"))


def test_standard_error_of_a_ratio_over_drives() -> None:
    above, below = np.array([[2.0], [4.0], [12.0], [6.0]]), np.array([[2.0], [2.0], [4.0], [4.0]])
    # Ratio 2; above - 2 below sums to -2 and 2 over the drives: sqrt(2 * 8) / 4 windows / the mean 3 below.
    np.testing.assert_allclose(ratio_drive_errors(above, below, names([2, 2])), [4 / 12])
    # A window in which one of the two is undefined counts in neither.
    more, less = np.append(above, [[9.0]], axis=0), np.append(below, [[math.nan]], axis=0)
    np.testing.assert_allclose(ratio_drive_errors(more, less, names([2, 3])), [4 / 12])


@given(st.lists(st.integers(1, 4), min_size=2, max_size=6), st.integers(0, 2**32 - 1))
def test_doubling_every_window_leaves_the_error_over_drives(windows: list[int], seed: int) -> None:
    """What is the same again tells nothing new; over windows the error would shrink by a third."""
    values = np.random.default_rng(seed).normal(size=(sum(windows), 2))
    twice = drive_errors(np.repeat(values, 2, axis=0), [name for name in names(windows) for _ in range(2)])
    np.testing.assert_allclose(twice, drive_errors(values, names(windows)), atol=1e-12)


def test_signs_by_hand() -> None:
    # 2^6 patterns; only both of one sign are as far out as six differences of one sign: 2/64.
    single, corrected = sign_tests(np.arange(1.0, 7)[:, None], np.random.default_rng(0))
    assert single.tolist() == corrected.tolist() == [2 / 64]
    # -1 among them: that pattern, the one without it, and their mirror images.
    single, _ = sign_tests(np.array([-1.0, 2, 3, 4, 5, 6])[:, None], np.random.default_rng(0))
    assert single == pytest.approx([4 / 64])
    # A second comparison that is the same costs nothing, one without any difference neither.
    sums = np.stack([np.arange(1.0, 7), 2 * np.arange(1.0, 7), np.zeros(6)], axis=1)
    single, corrected = sign_tests(sums, np.random.default_rng(0))
    assert single.tolist() == corrected.tolist() == [2 / 64, 2 / 64, 1]


def test_largest_statistic_corrects_by_its_definition() -> None:
    sums = np.random.default_rng(3).normal(0.5, 1, (7, 4))
    scaled = sums / np.sqrt((sums**2).sum(axis=0))
    turned = [np.abs((np.array(signs)[:, None] * scaled).sum(axis=0)) for signs in product((1, -1), repeat=7)]
    found = np.abs(scaled.sum(axis=0))
    single, corrected = sign_tests(sums, np.random.default_rng(0))
    np.testing.assert_allclose(single, [np.mean([t[k] >= found[k] - 1e-9 for t in turned]) for k in range(4)])
    np.testing.assert_allclose(corrected, [np.mean([t.max() >= found[k] - 1e-9 for t in turned]) for k in range(4)])
    assert (corrected >= single).all()


def test_many_drives_draw_patterns() -> None:
    sums = np.random.default_rng(1).normal(1, 1, (20, 1))
    (first,), _ = sign_tests(sums, np.random.default_rng(0))
    assert 1 / ENUMERATED <= first < 0.01
    assert sign_tests(sums, np.random.default_rng(0))[0] == [first]


@pytest.mark.parametrize("drives", [6, 10, 40])
def test_false_alarms_are_as_rare_as_promised(drives: int) -> None:
    """No effect, luck shared by the windows of a drive, twelve comparisons at once: a star in at most 7 %."""
    generator = np.random.default_rng(drives)
    alarms, rounds = 0, 600
    for _ in range(rounds):
        shared = lucky(generator, drives, 7)
        differences = np.concatenate([shared + lucky(generator, drives, 7) / 2 for _ in range(12)], axis=1)
        values = {"a": differences, "b": np.zeros_like(differences)}
        alarms += any(c.significant() for c in compare(values, names([7] * drives), [AB], range(12)))
    assert alarms / rounds <= 0.07


def test_power_for_the_difference_between_prednet_and_static() -> None:
    """That difference is twice its deviation between the drives (0.5 of static against 1): ten drives show it."""
    generator, rounds = np.random.default_rng(0), 200
    found = {}
    for drives in (6, 10):
        values = [{"a": lucky(generator, drives, 7, -4.0), "b": np.zeros((7 * drives, 1))} for _ in range(rounds)]
        compared = [compare(told, names([7] * drives), [AB], [0])[0] for told in values]
        found[drives] = sum(c.significant() for c in compared) / rounds
    assert found[6] > 0.8
    assert found[10] > 0.95


def test_interval_covers_as_often_as_it_says() -> None:
    generator, hits, rounds = np.random.default_rng(7), 0, 500
    for _ in range(rounds):
        values = lucky(generator, 6, 7, 1.0)
        low, high = interval(values.mean(axis=0), drive_errors(values, names([7] * 6)), 6)
        hits += bool(low[0] < 1.0 < high[0])
    assert 0.92 < hits / rounds < 0.98


def test_interval_by_the_tables_of_students_t() -> None:
    """At 97.5 % with one degree less than there are drives: 12.706 of one, 2.571 of five."""
    for drives, reach in ((2, 12.706), (6, 2.571)):
        low, high = interval(np.ones(1), np.full(1, 2.0), drives)
        assert (low[0], high[0]) == pytest.approx((1 - 2 * reach, 1 + 2 * reach), abs=2e-3)
    assert np.isnan(interval(np.zeros(1), np.zeros(1), 1)).all()


def test_comparisons() -> None:
    generator = np.random.default_rng(0)
    base = generator.random((40, 3))
    values = {
        "a": base,
        "b": base + 0.1 + 0.01 * generator.random((40, 3)),
        "c": base + generator.normal(0, 1, (40, 3)),
    }
    contrasts = [AB, Contrast("a", "c", "other?")]
    found = compare(values, names([5] * 8), contrasts, [0, 2], seed=1)
    assert [(c.contrast, c.horizon, c.drives) for c in found] == [(c, h, 8) for c in contrasts for h in (0, 2)]
    clear = found[1]
    assert clear.difference == pytest.approx(-0.105, abs=0.002)
    assert clear.low < clear.difference < clear.high < -0.1
    assert clear.p == pytest.approx(2 / 2**8)
    assert clear.significant()
    assert not found[2].significant()
    assert compare(values, names([5] * 8), contrasts, [0, 2], seed=1) == found
    assert compare(values, names([5] * 8), [], [0]) == []


def test_what_is_rarer_than_a_tenth_is_not_significant_at_a_twentieth() -> None:
    values = np.array([[-1.0], [2.0], [3.0], [4.0], [5.0], [6.0]])
    (only,) = compare({"a": values, "b": np.zeros_like(values)}, list("abcdef"), [AB], [0])
    assert only.p_corrected == pytest.approx(4 / 64)
    assert only.significant(0.1)
    assert not only.significant()


def test_drives_weigh_by_their_windows() -> None:
    # Sums -3, 1, 1, 1, 1, 1: of the 32 patterns with +3 five cancel out, the others are as far out as the 2 found.
    values = np.array([[-1.0]] * 3 + [[1.0]] * 5)
    (only,) = compare({"a": values, "b": np.zeros_like(values)}, names([3, 1, 1, 1, 1, 1]), [AB], [0])
    assert only.p == pytest.approx(54 / 64)


def test_two_drives_say_nothing() -> None:
    """All 14 windows one way: no probability, and an interval that owns up to two drives."""
    values = {"a": np.zeros((14, 1)), "b": np.repeat([[1.0], [2.0]], 7, axis=0)}
    (only,) = compare(values, names([7, 7]), [AB], [0])
    assert not only.significant()
    assert math.isnan(only.p)
    assert math.isnan(only.p_corrected)
    assert only.low < 0 < only.high
    (alone,) = compare(values, names([14]), [AB], [0])
    assert math.isnan(alone.low)


def test_undefined_windows_are_left_out() -> None:
    first = np.array([[1.0], [math.nan], [3.0], [4.0]])
    (only,) = compare({"a": first, "b": np.zeros((4, 1))}, list("abcd"), [AB], [0])
    assert only.drives == 3
    assert only.difference == pytest.approx(8 / 3)


def test_other_windows_are_refused() -> None:
    with pytest.raises(ValueError, match="same windows for all, not a: 2, b: 3"):
        compare({"a": np.zeros((2, 1)), "b": np.zeros((3, 1))}, list("ab"), [AB], [0])
