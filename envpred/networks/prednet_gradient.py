"""PredNet over a whole window with its backpropagation through time written out: what autograd would give, faster.

The gradient of a kernel is one convolution over all steps, not one a step.  Like the forward pass it does without the
upsampled grids, and activations' gradients are made in place.
"""

from collections.abc import Sequence
from itertools import chain
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn.functional import conv2d, conv_transpose2d, max_unpool2d

from envpred.networks.prednet_window import LayerWeights, Plan, Tape, forward, split_gates

# What autograd itself calls: the gradient before an activation from the one after it and the activation's output ...
relu_backward = torch.ops.aten.threshold_backward
hardtanh_backward = torch.ops.aten.hardtanh_backward
tanh_backward = torch.ops.aten.tanh_backward
# ... and the gradients of a convolution's input, kernel and bias.
convolution_backward = torch.ops.aten.convolution_backward


def unroll(frames: Tensor, lowest: Tensor, plan: Plan, weights: Sequence[LayerWeights]) -> tuple[Tensor, Tensor]:
    """Predictions (B, steps, C, H, W) and errors (B, steps, error_layers) of a window `frames` (B, T, C, H, W).

    Gradients flow to the frames and weights; everything else as in `prednet_window.forward`.
    """
    flat = list(chain.from_iterable(weights))
    keep = torch.is_grad_enabled() and any(tensor.requires_grad for tensor in (frames, *flat))
    predictions, errors = _Window.apply(frames, lowest, plan, keep, *flat)  # type: ignore[no-untyped-call]
    return predictions, errors


class _Window(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, frames: Tensor, lowest: Tensor, plan: Plan, keep: bool, *flat: Tensor
    ) -> tuple[Tensor, Tensor]:
        with torch.autocast(frames.device.type, enabled=False):
            predictions, errors, tape = forward(frames, lowest, plan, _layers(flat), keep)
        if keep:
            ctx.plan, ctx.frames_shape = plan, frames.shape
            ctx.lengths = [[len(entries) for entries in kept] for kept in tape]
            ctx.save_for_backward(lowest, *flat, *(entry for kept in tape for entries in kept for entry in entries))
        return predictions, errors

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, d_predictions: Tensor, d_errors: Tensor) -> tuple[Tensor | None, ...]:
        saved = iter(ctx.saved_tensors)
        lowest = next(saved)
        weights = _layers([next(saved) for _ in range(len(ctx.lengths) * len(LayerWeights._fields))])
        tape = [Tape(*([next(saved) for _ in range(n)] for n in lengths)) for lengths in ctx.lengths]
        with torch.autocast(d_predictions.device.type, enabled=False):
            d_shown, deltas = _backward(d_predictions, d_errors, lowest, ctx.plan, weights, tape)
            above = [kept.representation for kept in tape[1:]]
            d_weights = map(_weight_gradients, weights, tape, deltas, [*above, []])
            d_frames = None
            if ctx.needs_input_grad[0]:
                d_frames = d_predictions.new_zeros(ctx.frames_shape)
                for t, d_frame in enumerate(d_shown):
                    d_frames[:, t] = d_frame
            return (d_frames, None, None, None, *chain.from_iterable(d_weights))


class _Deltas(NamedTuple):
    """Gradients of what left the convolutions of one layer, one entry a step."""

    gates: list[Tensor]
    predict: list[Tensor]
    target: list[Tensor]


def _backward(
    d_predictions: Tensor,
    d_errors: Tensor,
    lowest: Tensor,
    plan: Plan,
    weights: Sequence[LayerWeights],
    tape: Sequence[Tape],
) -> tuple[list[Tensor], list[_Deltas]]:
    """The gradients of the frames shown and the deltas of the layers: `forward` from its last line to its first."""
    d_shown: list[Tensor] = []
    deltas = [_Deltas([], [], []) for _ in weights]
    # Through later steps: the gradients of each layer's R, E and cell, and of the prediction that the next step read.
    d_r = [torch.zeros_like(kept.representation[0]) for kept in tape]
    d_e = [torch.cat([d, d], 1) for d in d_r]
    d_cell = [torch.zeros_like(kept.cell[0]) for kept in tape]
    d_fed = torch.zeros_like(tape[0].prediction[0])
    for t in reversed(range(plan.steps)):
        d_prediction = d_fed + d_predictions[:, t]
        d_fed = torch.zeros_like(d_fed)
        for layer in reversed(range(plan.compared(t, len(weights)))):
            w, kept = weights[layer], tape[layer]
            if layer < plan.error_layers:
                d_e[layer] += d_errors[:, t, layer].view(-1, 1, 1, 1) / kept.error[t][0].numel()
            above, below = relu_backward(d_e[layer], kept.error[t], 0).chunk(2, 1)
            d_difference = above - below
            if layer > 0:
                delta = relu_backward(d_difference, kept.prediction[t], 0)
                deltas[layer].predict.append(delta)
                d_r[layer] += conv_transpose2d(delta, w.predict, padding=1)
                d_target = relu_backward(-d_difference, kept.target[t], 0)
                delta = max_unpool2d(d_target, kept.winners[t], [2, 2])
                deltas[layer - 1].target.append(delta)
                d_e[layer - 1] += conv_transpose2d(delta, weights[layer - 1].target, padding=1)
            elif t < plan.shown:
                d_prediction += d_difference
                d_shown.append(-d_difference)
            elif plan.stale:
                d_prediction += d_difference
                d_fed -= d_difference
        w, kept = weights[0], tape[0]
        inside = (kept.prediction[t] > lowest) & (kept.prediction[t] < 1)
        delta = (d_prediction * inside).to(w.predict.dtype)
        deltas[0].predict.append(delta)
        d_r[0] += conv_transpose2d(delta, w.predict, padding=1)
        for layer, (w, kept) in enumerate(zip(weights, tape, strict=True)):
            delta, d_cell[layer] = _lstm_backward(d_r[layer], d_cell[layer], kept, t)
            deltas[layer].gates.append(delta)
            if layer + 1 < len(weights):
                d_r[layer + 1] += conv2d(delta, w.above, stride=2, padding=1)
            if t > 0:
                s = w.predict.shape[0]
                d_own = conv_transpose2d(delta, w.gates, padding=1)
                d_r[layer], d_e[layer] = d_own[:, :s], d_own[:, s:]
    return d_shown[::-1], [_Deltas(*(entries[::-1] for entries in layer)) for layer in deltas]


def _lstm_backward(d_r: Tensor, d_cell: Tensor, kept: Tape, t: int) -> tuple[Tensor, Tensor]:
    """The gradients of the gates before their activations, and of the cell before step `t`."""
    gates, squashed = kept.gates[t], kept.squashed[t]
    i, f, o, candidate = gates.chunk(4, 1)
    delta = torch.empty_like(gates)
    d_i, d_f, d_o, d_candidate = delta.chunk(4, 1)
    d_cell = d_cell + tanh_backward(d_r * o, squashed)
    torch.mul(d_cell, candidate, out=d_i)
    torch.mul(d_r, squashed, out=d_o)
    torch.mul(d_cell, i, out=d_candidate)
    if t > 0:
        torch.mul(d_cell, kept.cell[t - 1], out=d_f)
    else:
        d_f.zero_()
    d_sigmoids, _ = split_gates(delta)
    sigmoids, _ = split_gates(gates)
    hardtanh_backward(d_sigmoids, sigmoids, 0, 1, grad_input=d_sigmoids)
    tanh_backward(d_candidate, candidate, grad_input=d_candidate)
    return delta, d_cell * f


def _weight_gradients(w: LayerWeights, kept: Tape, deltas: _Deltas, above: Sequence[Tensor]) -> LayerWeights:
    """The gradients of one layer's weights, all steps at once; `above` are the representations of the layer above."""
    own = [torch.cat(pair, 1) for pair in zip(kept.representation, kept.error, strict=False)]
    d_gates, _ = _gradients(own, deltas.gates[1:], w.gates)  # the layer's own state is zero before the first frame
    d_gates_bias = torch.stack([delta.sum((0, 2, 3)) for delta in deltas.gates]).sum(0)
    d_own = (d_gates, d_gates_bias, *_gradients(kept.representation, deltas.predict, w.predict))
    if not above:
        return LayerWeights(*d_own, w.above, w.target, w.target_bias)  # empty
    # Of a transposed convolution, so that what went in and what came out change places.
    d_above, _ = _gradients(deltas.gates, above, w.above, stride=2)
    return LayerWeights(*d_own, d_above, *_gradients(kept.error, deltas.target, w.target))


def _gradients(
    inputs: list[Tensor], deltas: Sequence[Tensor], kernel: Tensor, stride: int = 1
) -> tuple[Tensor, Tensor]:
    """The gradients of a convolution's `kernel` and bias; only as many `inputs` count as there are `deltas`."""
    n = len(kernel)
    if not deltas:
        return torch.zeros_like(kernel), kernel.new_zeros(n)
    stacked = torch.cat(inputs[: len(deltas)]), torch.cat(list(deltas))
    settings = ([n], [stride] * 2, [1, 1], [1, 1], False, [0, 0], 1)  # bias, stride, padding, dilation; not transposed
    _, d_kernel, d_bias = convolution_backward(stacked[1], stacked[0], kernel, *settings, [False, True, True])
    return d_kernel, d_bias


def _layers(flat: Sequence[Tensor]) -> list[LayerWeights]:
    n = len(LayerWeights._fields)
    return [LayerWeights(*flat[k : k + n]) for k in range(0, len(flat), n)]
