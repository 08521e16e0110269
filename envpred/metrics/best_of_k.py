"""Squared error of the best of k samples: whether what happened is among the futures that are held possible."""

from typing import Any

import torch
from torch import Tensor

from envpred.metrics.about import About
from envpred.metrics.cells import CellMetric
from envpred.metrics.windows import Judged

K = 16


class BestOfK(CellMetric):
    """Mean squared error of the best of the first k samples of a window: the one with the least error over all of it.

    More samples make this number smaller whatever they are worth, so k is the same for every forecaster: it is not
    defined for fewer samples than k.  A forecast without samples says the same k times, and has its own error.  Samples
    differ from their mean by what cannot be known, so that their best may well be worse than the mean.

    Args:
        horizons: steps that are forecast.
        k: samples that the best is of.

    >>> import torch
    >>> metric = BestOfK(horizons=2, k=2)
    >>> samples = torch.tensor([[0.2, 0.2], [0.0, 0.3]]).view(1, 2, 2, 1, 1)
    >>> metric.update(samples.mean(1), torch.zeros(1, 2, 1, 1), samples=samples)
    >>> [round(x, 4) for x in metric.compute()["mse_best_of_k"].mean.tolist()]  # 0.04 + 0.04 is less than 0 + 0.09
    [0.04, 0.04]
    """

    name = "mse_best_of_k"
    unit = "× 10⁻³"
    digits = 1
    factor = 1e3
    direction = "lower"
    higher_is_better = False
    rewards = "Rewards one future near what happened among many, and spread for its own sake."

    def __init__(self, horizons: int = 15, k: int = K, **kwargs: Any) -> None:
        super().__init__(horizons, **kwargs)
        if k < 1:
            raise ValueError(f"the best of {k} samples: give at least 1")
        self.k = k

    @property
    def about(self) -> About:
        return super().about._replace(title=f"MSE, best of {self.k}")

    def scores(self, judged: Judged) -> Tensor:
        if judged.samples is None:
            return (judged.forecast - judged.target).square()
        if judged.samples.shape[1] < self.k:
            return torch.full_like(judged.target, float("nan"))
        squares = (judged.samples[:, : self.k] - judged.target[:, None]).square()
        best = squares.mean((2, 3, 4)).argmin(1)
        return squares[torch.arange(len(best), device=best.device), best]
