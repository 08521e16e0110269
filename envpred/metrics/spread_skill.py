"""Spread against skill: do samples differ from each other as much as their mean errs?"""

import torch
from torch import Tensor

from envpred.metrics.cells import KINDS, KindsMetric, kinds_of, means
from envpred.metrics.ratios import Ratio, ratio_of_means
from envpred.metrics.windows import Judged


def spread_and_error(samples: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
    """Variance of the `samples` (B, K, N, H, W) of a cell, times (K + 1) / K, and squared error of their mean.

    Both (B, N, H, W), and the same in expectation if the `target` (B, N, H, W) is as one more sample: the variance is
    the unbiased one, and the mean of K has a K-th of it as an error of its own (Leutbecher and Palmer 2008; Fortin et
    al. 2014).
    """
    K = samples.shape[1]
    return samples.var(1) * ((K + 1) / K), (samples.mean(1) - target).square()


class SpreadSkill(KindsMetric):
    """Mean variance of the samples over mean squared error of their mean, per horizon; 1 is calibrated, less too sure.

    A ratio of means over all windows, since spread need not match skill in each.  Undefined without samples, or with a
    single one.

    >>> import torch
    >>> metric = SpreadSkill(horizons=1)
    >>> samples = torch.tensor([0.2, 0.4]).view(1, 2, 1, 1, 1)
    >>> metric.update(samples.mean(1), torch.full((1, 1, 1, 1), 0.5), samples=samples)
    >>> round(metric.compute()["spread_skill"].value.item(), 4)  # 3/2 x 0.02 over 0.04
    0.75
    """

    title = "Spread over skill"
    digits = 2
    direction = 1.0
    higher_is_better = None
    rewards = "Rewards samples that differ as much as their mean errs, however large that is."

    @property
    def width(self) -> int:
        return 2 * super().width

    def judge(self, judged: Judged) -> Tensor:
        samples = judged.samples
        if samples is None or samples.shape[1] < 2:
            return judged.target.new_full((len(judged.target), self.width), float("nan"))
        kinds = torch.cat([torch.ones_like(judged.target, dtype=torch.bool)[None], kinds_of(judged)])
        pairs = [means(scores, kinds) for scores in spread_and_error(samples, judged.target)]
        return torch.cat(pairs).transpose(0, 1).flatten(1)

    def compute(self) -> dict[str, Ratio]:
        """Over all windows seen in all processes."""
        _, values = self.rows()
        spread, error = values.view(-1, 2, 1 + len(KINDS), self.horizons).unbind(1)
        return {
            name: Ratio(*ratio_of_means(spread[:, kind], error[:, kind], True), self.about._replace(title=title))
            for kind, (name, title) in enumerate(zip(self.outputs, self.titles, strict=True))
        }
