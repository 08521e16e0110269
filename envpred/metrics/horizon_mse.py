"""Mean squared error of the probability of occupied, per horizon: the paper's measure, and that of its mass alone."""

from torch import Tensor

from envpred.metrics.windows import HorizonMetric, Judged


def horizon_mse(forecast: Tensor, target: Tensor) -> Tensor:
    """Mean over the cells of (forecast - target)^2: (B, N) of (B, N, H, W) probabilities."""
    return (forecast - target).square().mean(dim=(-2, -1))


class HorizonMSE(HorizonMetric):
    """Mean squared error over the cells of a grid, then mean and standard error over windows, per horizon.

    Itkina, Driggs-Campbell, Kochenderfer 2019, section IV.

    >>> import torch
    >>> metric = HorizonMSE(horizons=2)
    >>> target = torch.zeros(2, 2, 4, 4)
    >>> forecast = torch.tensor([0.1, 0.3]).view(2, 1, 1, 1).expand_as(target)
    >>> metric.update(forecast, target, index=torch.tensor([0, 1]))
    >>> metric.update(forecast[:1], target[:1], index=torch.tensor([0]))  # a padded duplicate counts once
    >>> result = metric.compute()
    >>> [round(x, 6) for x in result.mean.tolist()], [round(x, 6) for x in result.standard_error.tolist()]
    ([0.05, 0.05], [0.04, 0.04])
    """

    name = "mse"
    title = "MSE"
    unit = "× 10⁻³"
    digits = 1
    factor = 1e3
    direction = "lower"
    higher_is_better = False
    rewards = "Rewards the expected value of remembered evidence in every cell, measured or not; blur is safe."

    def measure(self, forecast: Tensor, target: Tensor, last: Tensor) -> Tensor:
        return horizon_mse(forecast, target)


class MassMSE(HorizonMSE):
    """Mean squared error against the mass of occupied, which counts what is unknown as free; undefined if not told.

    The particle filter forecasts this mass, and the errors that Itkina et al. 2019 print of it are near what it scores
    so, far from what it scores against the probability of occupied.

    >>> import torch
    >>> metric = MassMSE(horizons=1)
    >>> half = torch.full((1, 1, 2, 2), 0.5)
    >>> metric.update(half, half, mass=torch.full((1, 1, 2, 2), 0.2))
    >>> round(metric.compute().mean.item(), 4)
    0.09
    """

    name = "mse_occupied_mass"
    title = "MSE against the mass of occupied"
    skip_undefined = True
    rewards = "Rewards forecasts that take the unknown for free, as the particle filter's do."

    def judge(self, judged: Judged) -> Tensor:
        return horizon_mse(judged.forecast, judged.mass)
