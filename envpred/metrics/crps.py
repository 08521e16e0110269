"""Continuous ranked probability score: how far the samples of a cell lie from what was measured there."""

import torch
from torch import Tensor

from envpred.metrics.cells import CellMetric
from envpred.metrics.windows import Judged


def crps(samples: Tensor, target: Tensor) -> Tensor:
    """Fair CRPS of every cell (B, N, H, W) of `samples` (B, K, N, H, W) against the `target` (B, N, H, W).

    Mean |x_k - y| - sum over k < l of |x_k - x_l| / (K (K - 1)): what infinitely many samples of the same distribution
    would score, whatever their number (Ferro 2014).  A single one scores its absolute error.
    """
    K = samples.shape[1]
    error = (samples - target[:, None]).abs().mean(1)
    if K == 1:
        return error
    apart = torch.zeros_like(target)
    for step in range(1, K):
        apart += (samples[:, step:] - samples[:, :-step]).abs().sum(1)
    return error - apart / (K * (K - 1))


class CRPS(CellMetric):
    """Continuous ranked probability score (Hersbach 2000) of a cell's probability of occupied; least for the truth.

    A forecast without samples is one sample: its score is its absolute error.

    >>> import torch
    >>> metric = CRPS(horizons=1)
    >>> target = torch.full((1, 1, 1, 1), 0.4)
    >>> metric.update(target, target, samples=torch.tensor([0.2, 0.8]).view(1, 2, 1, 1, 1))
    >>> round(metric.compute()["crps"].mean.item(), 4)  # (0.2 + 0.4) / 2 - 0.6 / 2
    0.0
    """

    name = "crps"
    title = "CRPS"
    unit = "× 10⁻³"
    digits = 1
    factor = 1e3
    direction = "lower"
    higher_is_better = False
    rewards = "Rewards samples spread as what may happen is, cell by cell; they need not fit together."

    def scores(self, judged: Judged) -> Tensor:
        samples = judged.forecast[:, None] if judged.samples is None else judged.samples
        return crps(samples, judged.target)
