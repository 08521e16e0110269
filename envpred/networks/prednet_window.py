"""The forward pass of PredNet over a whole window: the numbers of `PredNet.step`, with less work.

* A 3 x 3 convolution over a grid that was upsampled twofold multiplies each coarse cell with up to four entries of the
  kernel for each fine one.  Summing those entries first leaves a transposed convolution of the coarse grid, stride 2,
  with a 4 x 4 kernel: 4/9 of the work.
* Nothing is computed that is known to be zero (a layer's own state before the first frame) or that reaches no output
  (the comparison at the last step, above the layers whose errors are wanted).
* The hard sigmoid's 0.2 x + 0.5 is part of the gates' kernels, and activations are made in place.
"""

from collections.abc import Sequence
from itertools import chain
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import avg_pool2d, conv2d, conv_transpose2d, max_pool2d


class Plan(NamedTuple):
    """What of a window is computed."""

    shown: int  # the steps that read a frame
    steps: int
    error_layers: int  # the lowest layers whose errors are wanted
    stale: bool  # whether the other steps read the prediction of the step before, or their own

    def compared(self, step: int, layers: int) -> int:
        """How many layers compare prediction and target at `step`: all, unless no later step reads the errors."""
        return layers if step < self.steps - 1 else self.error_layers


class LayerWeights(NamedTuple):
    """One layer's kernels and biases as the window is computed with them; the last three are empty in the top layer."""

    gates: Tensor  # (4 S, 3 S, 3, 3): i, f, o, candidate from [R, E] of the layer
    gates_bias: Tensor  # (4 S,)
    predict: Tensor  # (S, S, 3, 3): the prediction from R
    predict_bias: Tensor  # (S,)
    above: Tensor  # (S above, 4 S, 4, 4), transposed: the part of the gates that comes from R of the layer above
    target: Tensor  # (S above, 2 S, 3, 3): the target of the layer above from E
    target_bias: Tensor  # (S above,)

    @classmethod
    def prepare(
        cls, gates: nn.Conv2d, predict: nn.Conv2d, target: nn.Conv2d | None, dtype: torch.dtype
    ) -> "LayerWeights":
        """The weights of a layer's convolutions, in `dtype`; gradients flow back to them."""
        s = predict.out_channels
        scale, shift = torch.ones_like(_bias(gates)), torch.zeros_like(_bias(gates))
        scale[: 3 * s], shift[: 3 * s] = 0.2, 0.5
        kernel = gates.weight * scale.view(-1, 1, 1, 1)
        weights = [kernel[:, : 3 * s], _bias(gates) * scale + shift, predict.weight, _bias(predict)]
        if target is None:
            weights += [kernel.new_empty(0)] * 3
        else:
            # Entry m of the transposed kernel serves the fine cell whose entries 2 - m and 3 - m meet the coarse one.
            sums = avg_pool2d(kernel[:, 3 * s :].flip(2, 3), 2, stride=1, padding=1, divisor_override=1)
            weights += [sums.transpose(0, 1), target.weight, _bias(target)]
        return cls(*(dense(weight.to(dtype)) if weight.ndim == 4 else weight.to(dtype) for weight in weights))


class Tape(NamedTuple):
    """What one layer did, one entry a step."""

    gates: list[Tensor]  # i, f, o, candidate after their activations
    cell: list[Tensor]
    squashed: list[Tensor]  # tanh(cell)
    representation: list[Tensor]
    prediction: list[Tensor]
    target: list[Tensor]
    winners: list[Tensor]  # of the max pooling that made the target
    error: list[Tensor]


def forward(
    frames: Tensor, lowest: Tensor, plan: Plan, weights: Sequence[LayerWeights], keep: bool
) -> tuple[Tensor, Tensor, list[Tape]]:
    """Predictions (B, steps, C, H, W), errors (B, steps, error_layers) and, if it is to `keep` them, the layers' tapes.

    `frames` are (B, T, C, H, W).  Predictions are clipped to [`lowest` (C, 1, 1), 1].  Predictions, errors and LSTM
    cells have the type of `lowest`; the rest is computed in the type of the weights.
    """
    batch = len(frames)
    shown = dense(frames[:, : plan.shown].transpose(0, 1).flatten(0, 1)).chunk(plan.shown)
    tape = [Tape(*([] for _ in Tape._fields)) for _ in weights]
    predictions: list[Tensor] = []
    errors: list[Tensor] = []
    for t in range(plan.steps):
        _top_down(weights, tape, frames.shape, lowest)
        predictions.append(tape[0].prediction[-1])
        target = shown[t] if t < plan.shown else predictions[t - 1 if plan.stale else t]
        compared = plan.compared(t, len(weights))
        error = _bottom_up(weights[:compared], tape, target)
        errors += [e.mean(dim=(1, 2, 3), dtype=lowest.dtype) for e in error[: plan.error_layers]]
        if not keep:
            for entries in chain.from_iterable(tape):
                del entries[:-1]
    stacked = torch.stack(errors, 1) if errors else lowest.new_empty(batch, 0)
    return torch.stack(predictions, 1), stacked.view(batch, plan.steps, plan.error_layers), tape


def _top_down(weights: Sequence[LayerWeights], tape: Sequence[Tape], frames_shape: torch.Size, lowest: Tensor) -> None:
    """The representations of the coming step, and from the lowest the prediction of its frame."""
    batch, _, _, height, width = frames_shape
    above: Tensor | None = None
    for layer in reversed(range(len(weights))):
        w, kept = weights[layer], tape[layer]
        if kept.cell:
            own = torch.cat([kept.representation[-1], kept.error[-1]], 1)
            z = conv2d(own, w.gates, w.gates_bias, padding=1)
            if above is not None:
                z += conv_transpose2d(above, w.above, stride=2, padding=1)
        elif above is not None:
            z = conv_transpose2d(above, w.above, w.gates_bias, stride=2, padding=1)
        else:
            z = w.gates_bias.view(1, -1, 1, 1).expand(batch, -1, height >> layer, width >> layer)
            z = z.clone(memory_format=torch.channels_last)  # a copy in any case, for what follows is in place
        above = _lstm(z, kept, lowest.dtype)
    value = conv2d(tape[0].representation[-1], weights[0].predict, weights[0].predict_bias, padding=1)
    tape[0].prediction.append(torch.maximum(value.to(lowest.dtype), lowest).clamp_(max=1))


def _bottom_up(weights: Sequence[LayerWeights], tape: Sequence[Tape], target: Tensor) -> list[Tensor]:
    """The errors of the layers whose `weights` are given, the lowest against `target`."""
    errors: list[Tensor] = []
    for layer, (w, kept) in enumerate(zip(weights, tape, strict=False)):
        if layer > 0:
            below = weights[layer - 1]
            value = conv2d(tape[layer - 1].error[-1], below.target, below.target_bias, padding=1)
            target, winners = max_pool2d(value, 2, return_indices=True)
            kept.target.append(target.relu_())
            kept.winners.append(winners)
            kept.prediction.append(conv2d(kept.representation[-1], w.predict, w.predict_bias, padding=1).relu_())
        difference = kept.prediction[-1] - target
        errors.append(torch.cat([difference, -difference], 1).relu_())
        kept.error.append(errors[-1].to(w.gates.dtype))
    return errors


def _lstm(z: Tensor, kept: Tape, dtype: torch.dtype) -> Tensor:
    """The representation from the gates `z` (B, 4 S, h, w), whose activations are made in place."""
    sigmoids, candidate = split_gates(z)
    sigmoids.clamp_(0, 1)
    candidate.tanh_()
    i, f, o, candidate = z.chunk(4, 1)
    cell = (i * candidate).to(dtype)
    if kept.cell:
        cell.addcmul_(f, kept.cell[-1])
    squashed = cell.tanh()
    kept.gates.append(z)
    kept.cell.append(cell)
    kept.squashed.append(squashed)
    kept.representation.append((o * squashed).to(z.dtype))
    return kept.representation[-1]


def split_gates(gates: Tensor) -> tuple[Tensor, Tensor]:
    """The three sigmoid gates, and the candidate."""
    s = gates.shape[1] // 4
    return gates[:, : 3 * s], gates[:, 3 * s :]


def _bias(convolution: nn.Conv2d) -> Tensor:
    assert convolution.bias is not None
    return convolution.bias


def dense(x: Tensor) -> Tensor:
    """`x` in the memory order that convolutions are fastest in."""
    return x.contiguous(memory_format=torch.channels_last)
