"""PredNet over a whole window, its backpropagation through time written out: the numbers of `PredNet.step`, faster.

What it saves against steps that autograd records:

* The gradient of a kernel is one convolution over the steps stacked, not one a step.
* A 3 x 3 convolution over a grid that was upsampled twofold multiplies each coarse cell with up to nine entries of the
  kernel for each fine one.  Summing the entries first leaves a transposed convolution of the coarse grid, stride 2, with a
  4 x 4 kernel: 4/9 of the work, in both directions.
* Nothing is computed that is known to be zero (the layers' own state before the first frame) or that reaches no output
  (the comparison at the last step, above the layers whose errors are wanted).
* The hard sigmoid's 0.2 x + 0.5 is part of the gates' kernels, and activations are made in place.
"""

from collections.abc import Iterable, Sequence
from itertools import chain
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.nn.functional import avg_pool2d, conv2d, conv_transpose2d, max_pool2d, max_unpool2d
from torch.nn.grad import conv2d_weight

relu_backward = torch.ops.aten.threshold_backward
hardtanh_backward = torch.ops.aten.hardtanh_backward
tanh_backward = torch.ops.aten.tanh_backward


class Plan(NamedTuple):
    """What of a window is computed."""

    shown: int  # the steps that read a frame
    steps: int
    error_layers: int  # the lowest layers whose errors are wanted
    stale: bool  # whether later steps read the prediction of the step before, or their own

    def compared(self, step: int, layers: int) -> int:
        """How many layers compare their prediction at `step`: all, unless no later step reads the errors."""
        return layers if step < self.steps - 1 else self.error_layers


class LayerWeights(NamedTuple):
    """One layer's kernels and biases as the window is computed with them; the last three are None in the top layer."""

    gates: Tensor  # (4 S, 3 S, 3, 3): i, f, o, candidate from [R, E] of the layer
    gates_bias: Tensor  # (4 S,)
    predict: Tensor  # (S, S, 3, 3): the prediction from R
    predict_bias: Tensor  # (S,)
    above: Tensor | None  # (S above, 4 S, 4, 4), transposed: the part of the gates that comes from R of the layer above
    target: Tensor | None  # (S above, 2 S, 3, 3): the target of the layer above from E
    target_bias: Tensor | None  # (S above,)

    @classmethod
    def prepare(
        cls, gates: nn.Conv2d, predict: nn.Conv2d, target: nn.Conv2d | None, dtype: torch.dtype
    ) -> "LayerWeights":
        """The weights of a layer's convolutions, in `dtype`; gradients flow back to them."""
        s = predict.out_channels
        scale = torch.ones_like(gates.bias).index_fill(0, torch.arange(3 * s, device=gates.weight.device), 0.2)
        kernel = gates.weight * scale.view(-1, 1, 1, 1)
        bias = gates.bias * scale + 0.625 * (1 - scale)  # 0.5 where the scale is 0.2, else 0
        own = _dense(kernel[:, : 3 * s].to(dtype))
        weights = (own, bias.to(dtype), predict.weight.to(dtype), predict.bias.to(dtype))
        if target is None:
            return cls(*weights, None, None, None)
        # Entry m of the transposed kernel leads to the fine cell that meets the coarse one with its entries 2 - m and 3 - m.
        sums = avg_pool2d(kernel[:, 3 * s :].flip(2, 3), 2, stride=1, padding=1, divisor_override=1)
        return cls(*weights, _dense(sums.transpose(0, 1).to(dtype)), target.weight.to(dtype), target.bias.to(dtype))


class _Tape(NamedTuple):
    """What one layer did, one entry a step."""

    gates: list[Tensor]  # i, f, o, candidate after their activations
    cell: list[Tensor]
    squashed: list[Tensor]  # tanh(cell)
    representation: list[Tensor]
    prediction: list[Tensor]
    target: list[Tensor]
    winners: list[Tensor]  # of the max pooling that made the target
    error: list[Tensor]


def unroll(frames: Tensor, lowest: Tensor, plan: Plan, weights: Sequence[LayerWeights]) -> tuple[Tensor, Tensor]:
    """Predictions (B, steps, C, H, W) and errors (B, steps, error_layers) of a window `frames` (B, T, C, H, W).

    Predictions are clipped to [`lowest` (C, 1, 1), 1].  Predictions, errors and LSTM cells have the type of `lowest`, the
    rest is computed in the type of the weights.
    """
    flat = list(chain.from_iterable(weights))
    keep = torch.is_grad_enabled() and any(x.requires_grad for x in (frames, *flat) if x is not None)
    predictions, errors = _Window.apply(frames, lowest, plan, keep, *flat)
    return predictions, errors


class _Window(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, frames: Tensor, lowest: Tensor, plan: Plan, keep: bool, *flat: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        with torch.autocast(frames.device.type, enabled=False):
            predictions, errors, tape = _forward(frames, lowest, plan, _layers(flat), keep)
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
        tape = [_Tape(*([next(saved) for _ in range(n)] for n in lengths)) for lengths in ctx.lengths]
        with torch.autocast(d_predictions.device.type, enabled=False):
            d_shown, deltas = _backward(d_predictions, d_errors, lowest, ctx.plan, weights, tape)
            d_weights = [_weight_gradients(*layer) for layer in zip(weights, tape, deltas, (*tape[1:], None), strict=True)]
        d_frames = None
        if ctx.needs_input_grad[0]:
            d_frames = d_predictions.new_zeros(ctx.frames_shape)
            for t, d_frame in enumerate(d_shown):
                d_frames[:, t] = d_frame
        return (d_frames, None, None, None, *chain.from_iterable(d_weights))


def _forward(
    frames: Tensor, lowest: Tensor, plan: Plan, weights: Sequence[LayerWeights], keep: bool
) -> tuple[Tensor, Tensor, list[_Tape]]:
    batch, size = len(frames), frames.shape[3:]
    shown = _dense(frames[:, : plan.shown].transpose(0, 1).flatten(0, 1)).split(batch)
    tape = [_Tape(*([] for _ in _Tape._fields)) for _ in weights]
    predictions: list[Tensor] = []
    errors: list[Tensor] = []
    for t in range(plan.steps):
        above = None
        for layer in reversed(range(len(weights))):  # top-down
            w, kept = weights[layer], tape[layer]
            if t > 0:
                own = torch.cat([kept.representation[-1], kept.error[-1]], 1)
                z = conv2d(own, w.gates, w.gates_bias, padding=1)
                if above is not None:
                    z += conv_transpose2d(above, w.above, stride=2, padding=1)
            elif above is not None:
                z = conv_transpose2d(above, w.above, w.gates_bias, stride=2, padding=1)
            else:
                z = _dense(w.gates_bias.view(1, -1, 1, 1).expand(batch, -1, size[0] >> layer, size[1] >> layer))
            above = _lstm(z, kept, lowest.dtype)
        w, kept = weights[0], tape[0]
        value = conv2d(kept.representation[-1], w.predict, w.predict_bias, padding=1)
        predictions.append(torch.maximum(value.to(lowest.dtype), lowest).clamp_(max=1))
        kept.prediction.append(predictions[-1])
        for layer in range(plan.compared(t, len(weights))):  # bottom-up
            w, kept = weights[layer], tape[layer]
            if layer == 0:
                target = shown[t] if t < plan.shown else predictions[t - 1 if plan.stale else t]
            else:
                below = weights[layer - 1]
                value = conv2d(tape[layer - 1].error[-1], below.target, below.target_bias, padding=1)
                target, winners = max_pool2d(value, 2, return_indices=True)
                kept.target.append(target.relu_())
                kept.winners.append(winners)
                kept.prediction.append(conv2d(kept.representation[-1], w.predict, w.predict_bias, padding=1).relu_())
            difference = kept.prediction[-1] - target
            error = torch.cat([difference, -difference], 1).relu_()
            kept.error.append(error.to(w.gates.dtype))
            if layer < plan.error_layers:
                errors.append(error.mean(dim=(1, 2, 3), dtype=lowest.dtype))
        if not keep:
            for entries in chain.from_iterable(tape):
                del entries[:-1]
    stacked = torch.stack(errors, 1) if errors else predictions[0].new_empty(batch, 0)
    return torch.stack(predictions, 1), stacked.view(batch, plan.steps, plan.error_layers), tape


def _lstm(z: Tensor, kept: _Tape, dtype: torch.dtype) -> Tensor:
    """The representation from the gates `z` (B, 4 S, h, w) before their activations, which are made in place."""
    sigmoids, candidate = _split(z)
    sigmoids.clamp_(0, 1)
    candidate.tanh_()
    i, f, o, _ = z.chunk(4, 1)
    cell = (i * candidate).to(dtype)
    if kept.cell:
        cell += f * kept.cell[-1]
    squashed = cell.tanh()
    representation = (o * squashed).to(z.dtype)
    for entries, entry in zip(kept, (z, cell, squashed, representation), strict=False):
        entries.append(entry)
    return representation


class _Deltas(NamedTuple):
    """Gradients of what left the convolutions of one layer, one entry a step."""

    gates: list[Tensor]
    predict: list[Tensor]
    target: list[Tensor]


def _backward(
    d_predictions: Tensor, d_errors: Tensor, lowest: Tensor, plan: Plan, weights: Sequence[LayerWeights], tape: Sequence[_Tape]
) -> tuple[list[Tensor], list[_Deltas]]:
    """The gradients of the frames shown, the first first, and the deltas of the layers."""
    deltas = [_Deltas([], [], []) for _ in weights]
    d_shown: list[Tensor] = []
    # Gradients through the steps after the one at hand: of the representations, errors, cells, and of the prediction fed back.
    d_r = [torch.zeros_like(kept.representation[0]) for kept in tape]
    d_e = [torch.zeros_like(torch.cat([d, d], 1)) for d in d_r]
    d_cell = [torch.zeros_like(kept.cell[0]) for kept in tape]
    d_fed: Tensor | None = None
    for t in reversed(range(plan.steps)):
        d_prediction = _dense(d_predictions[:, t]) if d_fed is None else d_predictions[:, t] + d_fed
        d_fed = None
        for layer in reversed(range(plan.compared(t, len(weights)))):  # bottom-up, backwards
            w, kept = weights[layer], tape[layer]
            if layer < plan.error_layers:
                d_e[layer] += d_errors[:, t, layer].view(-1, 1, 1, 1) / kept.error[t][0].numel()
            more, less = relu_backward(d_e[layer], kept.error[t], 0).chunk(2, 1)
            d_difference = more - less
            if layer > 0:
                below = weights[layer - 1]
                delta = relu_backward(d_difference, kept.prediction[t], 0)
                deltas[layer].predict.append(delta)
                d_r[layer] += conv_transpose2d(delta, w.predict, padding=1)
                delta = max_unpool2d(relu_backward(-d_difference, kept.target[t], 0), kept.winners[t], 2)
                deltas[layer - 1].target.append(delta)
                d_e[layer - 1] += conv_transpose2d(delta, below.target, padding=1)
            elif t < plan.shown:
                d_prediction = d_prediction + d_difference
                d_shown.append(-d_difference)
            elif plan.stale:
                d_prediction = d_prediction + d_difference
                d_fed = -d_difference
        prediction = tape[0].prediction[t]
        delta = (d_prediction * ((prediction > lowest) & (prediction < 1))).to(d_r[0].dtype)
        deltas[0].predict.append(delta)
        d_r[0] += conv_transpose2d(delta, weights[0].predict, padding=1)
        for layer, (w, kept) in enumerate(zip(weights, tape, strict=True)):  # top-down, backwards
            delta, d_cell[layer] = _lstm_backward(d_r[layer], d_cell[layer], kept, t)
            deltas[layer].gates.append(delta)
            if w.above is not None:
                d_r[layer + 1] += conv2d(delta, w.above, stride=2, padding=1)
            if t > 0:
                s = d_r[layer].shape[1]
                d_r[layer], d_e[layer] = conv_transpose2d(delta, w.gates, padding=1).split([s, 2 * s], 1)
    return d_shown[::-1], [_Deltas(*(entries[::-1] for entries in layer)) for layer in deltas]


def _lstm_backward(d_r: Tensor, d_cell: Tensor, kept: _Tape, t: int) -> tuple[Tensor, Tensor]:
    """The gradients of the gates before their activations, and of the cell before step `t`."""
    gates, squashed = kept.gates[t], kept.squashed[t]
    i, f, o, candidate = gates.chunk(4, 1)
    delta = torch.empty_like(gates)
    d_i, d_f, d_o, d_candidate = delta.chunk(4, 1)
    d_cell = d_cell + tanh_backward(d_r * o, squashed)
    torch.mul(d_r, squashed, out=d_o)
    torch.mul(d_cell, candidate, out=d_i)
    torch.mul(d_cell, i, out=d_candidate)
    if t > 0:
        torch.mul(d_cell, kept.cell[t - 1], out=d_f)
    else:
        d_f.zero_()
    d_sigmoids, _ = _split(delta)
    sigmoids, _ = _split(gates)
    hardtanh_backward(d_sigmoids, sigmoids, 0, 1, grad_input=d_sigmoids)
    tanh_backward(d_candidate, candidate, grad_input=d_candidate)
    return delta, d_cell * f


def _weight_gradients(w: LayerWeights, kept: _Tape, deltas: _Deltas, kept_above: _Tape | None) -> LayerWeights:
    """The gradients of one layer's weights, all steps at once."""
    own = [torch.cat(pair, 1) for pair in zip(kept.representation, kept.error, strict=False)]
    d_gates, _ = _gradients(own, deltas.gates[1:], w.gates)  # the layer's own state is zero before the first step
    gates = torch.cat(deltas.gates)
    d_own = (d_gates, gates.sum((0, 2, 3)), *_gradients(kept.representation, deltas.predict, w.predict))
    if kept_above is None:
        return LayerWeights(*d_own, None, None, None)
    d_above = conv2d_weight(gates, w.above.shape, torch.cat(kept_above.representation), stride=2, padding=1)
    return LayerWeights(*d_own, d_above, *_gradients(kept.error, deltas.target, w.target))


def _gradients(inputs: Sequence[Tensor], deltas: Sequence[Tensor], kernel: Tensor) -> tuple[Tensor, Tensor]:
    """The gradients of a 3 x 3 `kernel` and of its bias."""
    if not deltas:
        return torch.zeros_like(kernel), kernel.new_zeros(len(kernel))
    delta = torch.cat(deltas)
    return conv2d_weight(torch.cat(inputs[: len(deltas)]), kernel.shape, delta, padding=1), delta.sum((0, 2, 3))


def _layers(flat: Iterable[Tensor | None]) -> list[LayerWeights]:
    flat = list(flat)
    n = len(LayerWeights._fields)
    return [LayerWeights(*flat[k : k + n]) for k in range(0, len(flat), n)]


def _split(gates: Tensor) -> tuple[Tensor, Tensor]:
    """The sigmoid gates and the candidate."""
    s = gates.shape[1] // 4
    return gates[:, : 3 * s], gates[:, 3 * s :]


def _dense(x: Tensor) -> Tensor:
    return x.contiguous(memory_format=torch.channels_last)
