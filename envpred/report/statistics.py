"""Are two forecasters different?  Paired comparisons over the same windows, corrected for their number."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy import stats

FloatArray = NDArray[np.float64]
BATCH = 2**22  # resampled values held at once: 32 MiB


@dataclass(frozen=True)
class Comparison:
    """`first` against `second` at column `horizon` of their per-window values, over `windows` windows.

    `difference` is mean(first - second), `low` and `high` its bootstrap confidence interval, `p` Wilcoxon's two-sided
    probability and `p_holm` the same corrected for all comparisons of the family.
    """

    first: str
    second: str
    horizon: int
    windows: int
    difference: float
    low: float
    high: float
    p: float
    p_holm: float

    def significant(self, level: float = 0.05) -> bool:
        """Whether the corrected test refuses equality at `level`."""
        return self.p_holm < level


def bootstrap_interval(
    difference: FloatArray, generator: np.random.Generator, level: float = 0.95, resamples: int = 10_000
) -> tuple[float, float]:
    """Confidence interval of the mean of paired differences (W,), whole windows drawn with replacement.

    Bias corrected and accelerated (Efron 1987), as scipy computes it.  NaN for fewer than two windows.  Windows of one
    drive are alike: the interval speaks of other windows of the same drives rather than of other drives.
    """
    difference = np.asarray(difference, np.float64)
    if len(difference) < 2:
        return float("nan"), float("nan")
    if np.ptp(difference) == 0:  # no spread to resample; the acceleration would be 0/0
        return float(difference[0]), float(difference[0])
    result = stats.bootstrap(
        (difference,),
        np.mean,
        n_resamples=resamples,
        batch=max(1, BATCH // len(difference)),
        confidence_level=level,
        method="BCa",
        rng=generator,
    )
    return float(result.confidence_interval.low), float(result.confidence_interval.high)


def wilcoxon(difference: FloatArray) -> float:
    """Two-sided p of Wilcoxon's signed-rank test (1945) that paired differences (W,) are symmetric about 0.

    Windows without a difference drop out; p = 1 if none is left.  Exact for up to 50 windows without ties.
    """
    difference = np.asarray(difference, np.float64)
    return float(stats.wilcoxon(difference).pvalue) if difference.any() else 1.0


def holm(p: FloatArray) -> FloatArray:
    """Probabilities (K,) corrected so that the chance of any false alarm among them stays below the level.

    Holm 1979.
    """
    p = np.asarray(p, np.float64)
    order = np.argsort(p)
    factors = np.arange(len(p), 0, -1)
    corrected = np.empty_like(p)
    corrected[order] = np.minimum(1.0, np.maximum.accumulate(p[order] * factors))
    return corrected


def compare_pairs(
    values: Mapping[str, NDArray[np.floating]], horizons: Sequence[int], seed: int = 0, resamples: int = 10_000
) -> list[Comparison]:
    """Compare every pair among `values` (name -> (W, N) of the same windows) at the columns `horizons`.

    The correction is over all pairs and columns together.  Windows that are NaN (undefined) for either are left out.
    Raises ValueError if the numbers of windows differ.
    """
    if len({len(array) for array in values.values()}) > 1:
        sizes = ", ".join(f"{name}: {len(array)}" for name, array in values.items())
        raise ValueError(f"paired comparison needs the same windows for all, not {sizes}")
    generator = np.random.default_rng(seed)
    found = []
    for first, second in combinations(values, 2):
        for horizon in horizons:
            difference = np.asarray(values[first], np.float64)[:, horizon] - values[second][:, horizon]
            difference = difference[np.isfinite(difference)]
            mean = float(difference.mean()) if len(difference) else float("nan")
            low, high = bootstrap_interval(difference, generator, resamples=resamples)
            p = wilcoxon(difference)
            found.append(Comparison(first, second, horizon, len(difference), mean, low, high, p, p))
    corrected = holm(np.array([comparison.p for comparison in found]))
    return [replace(comparison, p_holm=float(p)) for comparison, p in zip(found, corrected, strict=True)]
