"""Samples of a forecast whose mean has been corrected."""

from torch import Tensor


def recentred(samples: Tensor, mean: Tensor) -> Tensor:
    """Probabilities `samples` (B, K, N, H, W), moved so that their mean is `mean` (B, N, H, W).

    In each cell all go the same share of their way to 1, or to 0: they stay probabilities, and keep their order.
    """
    before, after = samples.mean(1, keepdim=True), mean[:, None]
    down = after / before.clamp(min=1e-6)
    up = (1 - after) / (1 - before).clamp(min=1e-6)
    lowered, raised = samples * down, 1 - (1 - samples) * up
    return lowered.where(after < before, raised).clamp(0, 1)
