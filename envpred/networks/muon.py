"""Muon (Jordan et al. 2024): momentum whose updates are made orthogonal, for weights of two or more dimensions.

Kernels of convolutions count as matrices, one row an output channel.  What has one dimension goes by AdamW, in the same
optimiser, so that there is one schedule and one state in a checkpoint.
"""

from collections.abc import Callable, Iterable
from typing import Any

import torch
from torch import Tensor
from torch.optim import Optimizer


class Muon(Optimizer):
    """Muon for the `matrices`, AdamW for the `others`.

    Args:
        matrices: parameters of two or more dimensions.
        others: all that is left, biases and factors.
        lr: learning rate of the matrices.
        others_lr: that of the others.
        momentum: share of the past in the matrices' momentum.
        weight_decay: of both.
    """

    def __init__(
        self,
        matrices: Iterable[Tensor],
        others: Iterable[Tensor],
        lr: float = 0.07,
        others_lr: float = 7e-3,
        momentum: float = 0.95,
        weight_decay: float = 1e-2,
    ) -> None:
        common = {"weight_decay": weight_decay}
        super().__init__(
            [
                {"params": list(matrices), "lr": lr, "momentum": momentum, **common},
                {"params": list(others), "lr": others_lr, "betas": (0.9, 0.99), "eps": 1e-8, **common},
            ],
            {},
        )

    @torch.no_grad()
    def step(self, closure: Callable[[], float] | None = None) -> float | None:  # type: ignore[override]
        """One step by the gradients that are there."""
        loss = None
        if closure is not None:
            with torch.enable_grad():
                loss = closure()
        for group in self.param_groups:
            update = self._orthogonal if "momentum" in group else self._adam
            for parameter in group["params"]:
                if parameter.grad is not None:
                    parameter.mul_(1 - group["lr"] * group["weight_decay"])
                    update(parameter, group)
        return loss

    def _orthogonal(self, parameter: Tensor, group: dict[str, Any]) -> None:
        state = self.state[parameter]
        if not state:
            state["momentum"] = torch.zeros_like(parameter)
        state["momentum"].lerp_(parameter.grad, 1 - group["momentum"])
        gradient = parameter.grad.lerp(state["momentum"], group["momentum"])  # type: ignore[union-attr]
        rows = gradient.reshape(len(gradient), -1)
        update = orthogonal(rows) * max(1.0, rows.shape[0] / rows.shape[1]) ** 0.5
        parameter.add_(update.view_as(parameter), alpha=-group["lr"])

    def _adam(self, parameter: Tensor, group: dict[str, Any]) -> None:
        state, (first, second) = self.state[parameter], group["betas"]
        if not state:
            state |= {"step": 0, "mean": torch.zeros_like(parameter), "square": torch.zeros_like(parameter)}
        gradient: Tensor = parameter.grad  # type: ignore[assignment]
        state["step"] += 1
        state["mean"].lerp_(gradient, 1 - first)
        state["square"].lerp_(gradient.square(), 1 - second)
        mean, square = state["mean"] / (1 - first ** state["step"]), state["square"] / (1 - second ** state["step"])
        parameter.addcdiv_(mean, square.sqrt().add_(group["eps"]), value=-group["lr"])


def orthogonal(matrix: Tensor, steps: int = 5) -> Tensor:
    """The orthogonal matrix nearest to `matrix` (m, n), nearly: a quintic Newton-Schulz iteration (Jordan et al. 2024).

    Singular values end between 0.7 and 1.2, which is near enough for an update.
    """
    x = matrix / (matrix.norm() + 1e-7)
    tall = x.shape[0] > x.shape[1]
    x = x.T if tall else x
    for _ in range(steps):
        gram = x @ x.T
        x = 3.4445 * x + (-4.7750 * gram + 2.0315 * gram @ gram) @ x
    nearest: Tensor = x.T if tall else x
    return nearest
