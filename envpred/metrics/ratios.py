"""Ratios of means over windows, with their standard error."""

from typing import Any

import torch
from torch import Tensor

from envpred.metrics.about import About
from envpred.metrics.windows import without_nan


class Ratio:
    """`value` (N,) and its `standard_error` (N,) over all windows taken together; `about` says how it is written."""

    def __init__(self, value: Tensor, standard_error: Tensor, about: About) -> None:
        self.value, self.standard_error, self.about = value, standard_error, about

    def as_json(self) -> dict[str, Any]:
        """Lists for a result file, None where a value is undefined, and how they are written."""
        return {
            **self.about._asdict(),
            "mean": without_nan(self.value.tolist()),
            "standard_error": without_nan(self.standard_error.tolist()),
        }


def ratio_of_means(numerator: Tensor, denominator: Tensor, skip_undefined: bool = False) -> tuple[Tensor, Tensor]:
    """mean(numerator) / mean(denominator) over windows (W, N), row by row, and its standard error (delta method).

    With `skip_undefined` a window in which either is NaN does not count there; without, NaN is passed on.  A single
    window has no standard error, and none has no ratio.
    """
    numerator, denominator = numerator.double(), denominator.double()
    undefined = numerator.isnan() | denominator.isnan()
    counted = ~undefined if skip_undefined else torch.ones_like(undefined)
    n = counted.sum(0)
    above, below = numerator.where(counted, 0.0), denominator.where(counted, 0.0)
    scale = below.sum(0) / n
    ratio = above.sum(0) / n / scale
    residual = above - ratio * below  # its mean over windows is 0
    error = (residual.square().sum(0) / (n - 1).clamp(min=0) / n).sqrt() / scale
    return ratio, error
