"""Are two forecasters different?  Contrasts that were planned, tested over drives, corrected for their number.

Windows of one drive share its road, speed and weather: errors on them are alike, and what holds on all windows of two
drives may hold on no third.  So the drive is the unit of chance.  A standard error over drives is that of a mean over
clusters (Liang and Zeger 1986), an interval takes Student's t with one degree less than there are drives (Cameron and
Miller 2015), and a test turns the signs of whole drives round.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy import stats

FloatArray = NDArray[np.float64]
LEVEL = 0.05
LEAST_DRIVES = 6  # of fewer, not even all signs alike are rarer than the level: 2^(1 - 5) = 0.0625
ENUMERATED = 2**13  # patterns of signs up to which all are counted, and that are drawn beyond
ALIKE = 1e-9  # relative; statistics that differ by rounding are equal


@dataclass(frozen=True)
class Contrast:
    """Two methods, by their labels, and the question that comparing them answers."""

    first: str
    second: str
    question: str


@dataclass(frozen=True)
class Comparison:
    """A `contrast` at column `horizon` of the values by window, over `drives` drives.

    `difference` is mean(first - second) over the windows, `low` and `high` its 95 % confidence interval, `p` the
    two-sided probability of a sign test over drives and `p_corrected` the same corrected for all contrasts and
    horizons; NaN where there are too few drives for either.
    """

    contrast: Contrast
    horizon: int
    drives: int
    difference: float
    low: float
    high: float
    p: float
    p_corrected: float

    def significant(self, level: float = LEVEL) -> bool:
        """Whether the corrected test refuses equality at `level`; never with fewer than six drives, which have no p."""
        return self.p_corrected < level


def by_drive(values: FloatArray, drives: Sequence[str]) -> tuple[FloatArray, FloatArray]:
    """Sums and numbers (D, N) of the defined among `values` (W, N), by the drive of each window, in its order."""
    if len(values) != len(drives):
        raise ValueError(f"{len(values)} windows have {len(drives)} drives")
    names = {name: d for d, name in enumerate(dict.fromkeys(drives))}
    place = np.array([names[name] for name in drives], np.intp)
    counted = np.isfinite(values)
    sums, counts = np.zeros((2, len(names), values.shape[1]))
    np.add.at(sums, place, np.where(counted, values, 0))
    np.add.at(counts, place, counted)
    return sums, counts


def drive_errors(values: FloatArray, drives: Sequence[str]) -> FloatArray:
    """Standard errors (N,) over drives of the means over windows of `values` (W, N); NaN for fewer than two drives.

    sqrt(D / (D - 1) sum_d (sum_w (x_dw - mean))^2) / W: errors of one drive's windows add up before they are squared.
    """
    sums, counts = by_drive(np.asarray(values, np.float64), drives)
    return _spread(sums, counts)[1]


def ratio_drive_errors(above: FloatArray, below: FloatArray, drives: Sequence[str]) -> FloatArray:
    """Standard errors (N,) over drives of mean(above) / mean(below) over windows (W, N), by the delta method.

    A window in which either is undefined does not count.
    """
    above, below = np.array(above, np.float64), np.array(below, np.float64)
    undefined = ~(np.isfinite(above) & np.isfinite(below))
    above[undefined] = below[undefined] = np.nan
    (over, _), (under, _) = by_drive(above, drives), by_drive(below, drives)
    return _spread(over, under)[1]


def _spread(sums: FloatArray, counts: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Means (N,) of sums over counts (D, N), and their standard errors over the drives that have any."""
    having = (counts > 0).sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        total = counts.sum(axis=0)
        mean = sums.sum(axis=0) / total
        squares = np.square(sums - mean * counts).sum(axis=0)
        return mean, np.sqrt(np.where(having > 1, having / (having - 1.0) * squares, np.nan)) / total


def interval(mean: FloatArray, error: FloatArray, drives: int, level: float = 0.95) -> tuple[FloatArray, FloatArray]:
    """Confidence interval of a mean with its standard error over drives; NaN for fewer than two drives."""
    half = stats.t.ppf((1 + level) / 2, drives - 1) * error if drives > 1 else np.full_like(error, np.nan)
    return mean - half, mean + half


def sign_tests(sums: FloatArray, generator: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Two-sided probabilities (K,), single and corrected for their number, that sums (D, K) over drives are about 0.

    Were two methods equal, a drive's difference might as well have the other sign.  Signs are turned round for all K
    differences of a drive at once, and the largest of their statistics is what the corrected probability is of
    (Westfall and Young 1993): methods that err alike cost less than Bonferroni's or Holm's correction takes.  All 2^D
    patterns are counted up to 13 drives, 2^13 random ones beyond.  1 where there is no difference.
    """
    drives, columns = sums.shape
    scale = np.sqrt(np.square(sums).sum(axis=0))  # whatever the signs are
    found = np.divide(sums, scale, out=np.zeros_like(sums), where=scale > 0)
    if 2**drives <= ENUMERATED:
        signs = np.array(list(product((1.0, -1.0), repeat=drives)))
    else:
        signs = generator.choice((1.0, -1.0), (ENUMERATED, drives))
        signs[0] = 1  # what was measured is one of the patterns
    statistic = np.abs(found.sum(axis=0))
    turned = np.abs(signs @ found)  # (patterns, K)
    least = statistic * (1 - ALIKE)
    largest = turned.max(axis=1, initial=0)
    single = (turned >= least).mean(axis=0)
    corrected = np.array([(largest >= value).mean() for value in least])
    different = scale > 0
    return np.where(different, single, 1.0), np.where(different, corrected, 1.0).reshape(columns)


def compare(
    values: Mapping[str, NDArray[np.floating]],
    drives: Sequence[str],
    contrasts: Sequence[Contrast],
    horizons: Sequence[int],
    seed: int = 0,
) -> list[Comparison]:
    """Compare `values` (label -> (W, N) of the same windows) as the `contrasts` say, at the columns `horizons`.

    Args:
        values: of each method.
        drives: the drive of each window.
        contrasts: what to compare; the correction is over all of them and all columns together.
        horizons: columns.
        seed: of the patterns of signs, where they are drawn.

    Windows that are NaN (undefined) for either are left out.

    Raises:
        ValueError: if the numbers of windows differ.
    """
    if len({len(array) for array in values.values()}) > 1:
        sizes = ", ".join(f"{name}: {len(array)}" for name, array in values.items())
        raise ValueError(f"paired comparison needs the same windows for all, not {sizes}")
    if not contrasts:
        return []
    at = list(horizons)
    differences = [
        np.asarray(values[contrast.first], np.float64)[:, at] - np.asarray(values[contrast.second], np.float64)[:, at]
        for contrast in contrasts
    ]
    sums, counts = by_drive(np.concatenate(differences, axis=1), drives)
    mean, error = _spread(sums, counts)
    p, corrected = sign_tests(sums, np.random.default_rng(seed))
    numbers = (counts > 0).sum(axis=0).tolist()
    found = []
    for k, number in enumerate(numbers):
        low, high = interval(mean[k], error[k], number)
        tested = (float(p[k]), float(corrected[k])) if number >= LEAST_DRIVES else (np.nan, np.nan)
        contrast, horizon = contrasts[k // len(at)], at[k % len(at)]
        found.append(Comparison(contrast, horizon, number, float(mean[k]), float(low), float(high), *tested))
    return found
