"""A metric of your own: `envpred test --results.metrics '[metric.Confidence]'` in this file's folder."""

from torch import Tensor

from envpred.metrics.windows import HorizonMetric


class Confidence(HorizonMetric):
    """Mean distance of a forecast from 0.5, which says nothing: 0.5 for one who is sure of every cell."""

    title, unit, digits, factor, direction = "Confidence", "", 3, 1.0, "higher"
    higher_is_better = True
    rewards = "Rewards boldness, right or wrong."

    def measure(self, forecast: Tensor, target: Tensor, last: Tensor) -> Tensor:
        return (forecast - 0.5).abs().mean(dim=(-2, -1))
