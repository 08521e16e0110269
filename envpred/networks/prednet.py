"""PredNet (Lotter, Kreiman, Cox 2017), equal to the authors' Keras layer in the form that the paper uses.

Layer l works on H/2^l x W/2^l cells.  Its four parts have the names of the PredNet paper: the *representation*
R (a convolutional LSTM), the *prediction* Ahat of the layer's input, that input or *target* A, and the *error* E of the
prediction.  All kernels are 3 x 3 with zero padding.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Literal, NamedTuple, Self, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from envpred.networks.prednet_gradient import unroll
from envpred.networks.prednet_window import LayerWeights, Plan, dense

KERAS_GATES = "ifoc"  # the order of the gates within our fused convolution: the three sigmoids, then the candidate


class PredNetState(NamedTuple):
    """What PredNet remembers between two frames; never written to, so several rollouts may start from one state."""

    representation: tuple[Tensor, ...]  # R_l (B, S_l, H/2^l, W/2^l), from which the coming frame is predicted
    cell: tuple[Tensor, ...]  # the LSTM's memory, same shapes
    prediction: Tensor  # (B, C, H, W) the forecast of the coming frame
    previous: Tensor  # (B, C, H, W) the forecast of the frame before that


class Unrolled(NamedTuple):
    """PredNet over a whole window."""

    predictions: Tensor  # (B, T, C, H, W); [:, t] was made before frame t was seen
    errors: Tensor  # (B, T, layers), mean of E_l over its channels and cells


class PredNet(nn.Module):
    """The predictive coding network over grids of `channels[0]` channels; `channels` (S_0, S_1, ...) one a layer.

    `feedback` says what the network reads once no frames are shown: its forecast of the frame before ("stale", the
    original) or of the frame itself ("current", which makes layer 0's error zero).

    The original's output is clipped to [0, 1].  Input channels in `signed_channels` (velocities scaled to [-1, 1]) are
    clipped to [-1, 1] instead: the same straight line inside the range, so that still and moving grids are learned
    alike, with the gradient alive at zero, where a ReLU's ends, and the ends of the range within reach, which a tanh
    never gets to.
    """

    def __init__(
        self,
        channels: Sequence[int],
        feedback: Literal["stale", "current"] = "stale",
        signed_channels: Sequence[int] = (),
    ) -> None:
        super().__init__()
        if not channels or min(channels) < 1:
            raise ValueError(f"PredNet needs at least one layer, each of at least one channel, not {tuple(channels)}")
        if feedback not in ("stale", "current"):
            raise ValueError(f"feedback is 'stale' or 'current', not {feedback!r}")
        if not set(signed_channels) <= set(range(channels[0])):
            raise ValueError(f"signed_channels {tuple(signed_channels)} are not among the {channels[0]} input channels")
        self.channels = tuple(channels)
        self.feedback = feedback
        self.signed_channels = tuple(sorted(signed_channels))
        above = (*self.channels[1:], 0)
        self.gates = _convolutions([(3 * s + up, 4 * s) for s, up in zip(self.channels, above, strict=True)])
        self.predict = _convolutions([(s, s) for s in self.channels])
        self.target = _convolutions([(2 * s, up) for s, up in pairwise(self.channels)])
        self.lowest: Tensor
        lowest = torch.zeros(self.channels[0], 1, 1)
        lowest[list(self.signed_channels)] = -1.0
        self.register_buffer("lowest", lowest, persistent=False)
        self.reset_parameters()

    def reset_parameters(self) -> None:
        """Initialise as Keras does: Glorot uniform kernels, each gate by itself, and zero biases."""
        for convolutions, fused in ((self.gates, 4), (self.predict, 1), (self.target, 1)):
            for convolution in convolutions:
                for kernel in convolution.weight.detach().chunk(fused):
                    nn.init.xavier_uniform_(kernel)
                nn.init.zeros_(cast(Tensor, convolution.bias))

    @classmethod
    def from_keras(cls, arrays: Mapping[str, NDArray[np.floating]], **options: object) -> Self:
        """The network whose weights Keras named `<gate>_<layer>/kernel` (kh, kw, cin, cout) and `/bias`.

        Gates: a, ahat, c, f, i, o.  `options` go to the constructor.  Raises ValueError if an array is
        missing or does not fit.
        """
        layers = sum(name.startswith("ahat_") and name.endswith("/bias") for name in arrays)
        try:
            network = cls([arrays[f"ahat_{layer}/bias"].size for layer in range(layers)], **options)  # type: ignore[arg-type]
            for layer in range(layers):
                _copy_keras(network.gates[layer], [f"{gate}_{layer}" for gate in KERAS_GATES], arrays)
                _copy_keras(network.predict[layer], [f"ahat_{layer}"], arrays)
            for layer in range(layers - 1):
                _copy_keras(network.target[layer], [f"a_{layer}"], arrays)
        except KeyError as missing:
            raise ValueError(f"a Keras PredNet of {layers} layers needs the array {missing}") from None
        return network

    def forward(self, frames: Tensor, given: int | None = None, steps: int | None = None) -> Tensor:
        """Predictions (B, T', C, H, W) of a window `frames` (B, T, C, H, W); [:, t] is made before frame t is seen.

        The first `given` frames are shown (default all), then the network reads its own predictions, through which
        gradients flow.  `steps` is T' (default T) and may exceed T.
        """
        return self.unroll(frames, given, steps, error_layers=0).predictions

    def unroll(
        self, frames: Tensor, given: int | None = None, steps: int | None = None, error_layers: int | None = None
    ) -> Unrolled:
        """As `forward`, with the errors (B, T', error_layers) of the lowest `error_layers` layers (default all).

        Once no frames are shown, errors are those against the prediction that is read in the frame's place.
        """
        if torch.compiler.is_compiling():
            return self.unroll_by_steps(frames, given, steps, error_layers)
        plan = self._plan(frames, given, steps, error_layers)
        device = frames.device.type
        dtype = torch.get_autocast_dtype(device) if torch.is_autocast_enabled(device) else self.lowest.dtype
        convolutions = zip(self.gates, self.predict, (*self.target, None), strict=True)
        weights = [LayerWeights.prepare(*layer, dtype) for layer in convolutions]
        return Unrolled(*unroll(frames, self.lowest, plan, weights))

    def unroll_by_steps(
        self, frames: Tensor, given: int | None = None, steps: int | None = None, error_layers: int | None = None
    ) -> Unrolled:
        """As `unroll`, step by step as autograd records them: slower, but the form that torch.compile takes."""
        plan = self._plan(frames, given, steps, error_layers)
        state = self.initial_state(len(frames), *frames.shape[3:])
        predictions, errors = [], []
        for t in range(plan.steps):
            predictions.append(state.prediction)
            state, error = self._advance(frames[:, t] if t < plan.shown else None, state)
            errors += [e.mean(dim=(1, 2, 3)) for e in error[: plan.error_layers]]
        stacked = torch.stack(errors, 1) if errors else frames.new_empty(len(frames), 0)
        return Unrolled(torch.stack(predictions, 1), stacked.view(len(frames), plan.steps, plan.error_layers))

    def initial_state(self, batch: int, height: int, width: int) -> PredNetState:
        """The state before any frame of a stream of `batch` grids of `height` x `width` cells."""
        self._check_size(height, width)
        weight = self.predict[0].weight
        sizes = [(batch, s, height >> layer, width >> layer) for layer, s in enumerate(self.channels)]
        zero = [dense(torch.zeros(size, dtype=weight.dtype, device=weight.device)) for size in sizes]
        error = [torch.cat([z, z], 1) for z in zero]
        return self._predict(error, PredNetState(tuple(zero), tuple(zero), zero[0], zero[0]))

    def step(self, frame: Tensor | None, state: PredNetState) -> tuple[Tensor, PredNetState]:
        """Read the coming `frame` (B, C, H, W), or the own prediction if None; return the forecast of the one after it.

        The forecast is also `state.prediction` of the state returned, and the given state stays as it was.
        """
        state, _ = self._advance(frame, state)
        return state.prediction, state

    def _advance(self, frame: Tensor | None, state: PredNetState) -> tuple[PredNetState, list[Tensor]]:
        if frame is None:
            frame = state.previous if self.feedback == "stale" else state.prediction
        error = self._compare(frame, state)
        return self._predict(error, state), error

    def _compare(self, frame: Tensor, state: PredNetState) -> list[Tensor]:
        """The bottom-up pass: the errors E_l (B, 2 S_l, H/2^l, W/2^l) of the predictions of `frame`."""
        errors: list[Tensor] = []
        target, prediction = frame, state.prediction
        for layer in range(len(self.channels)):
            if layer > 0:
                target = functional.max_pool2d(self.target[layer - 1](errors[-1]), 2).relu()
                prediction = self.predict[layer](state.representation[layer]).relu()
            difference = prediction - target
            errors.append(torch.cat([difference, -difference], 1).relu())
        return errors

    def _predict(self, errors: Sequence[Tensor], state: PredNetState) -> PredNetState:
        """The top-down pass: representations, and from the lowest the prediction of the coming frame."""
        representation, cell = list(state.representation), list(state.cell)
        for layer in reversed(range(len(self.channels))):
            inputs = [representation[layer], errors[layer]]
            if layer + 1 < len(self.channels):
                inputs.append(functional.interpolate(representation[layer + 1], scale_factor=2, mode="nearest"))
            gates = self.gates[layer](torch.cat(inputs, 1))
            s = self.channels[layer]
            i, f, o = (0.2 * gates[:, : 3 * s] + 0.5).clamp(0, 1).chunk(3, 1)  # Keras's hard sigmoid
            cell[layer] = f * cell[layer] + i * gates[:, 3 * s :].tanh()
            representation[layer] = o * cell[layer].tanh()
        prediction = self._output(self.predict[0](representation[0]))
        return PredNetState(tuple(representation), tuple(cell), prediction, state.prediction)

    def _output(self, value: Tensor) -> Tensor:
        if self.signed_channels:
            return torch.where(self.lowest < 0, value.clamp(-1, 1), value.relu().clamp(max=1))
        return value.relu().clamp(max=1)

    def _plan(self, frames: Tensor, given: int | None, steps: int | None, error_layers: int | None) -> Plan:
        """What is asked for, checked."""
        if frames.ndim != 5 or frames.shape[2] != self.channels[0]:
            raise ValueError(f"PredNet of {self.channels[0]} channels reads (B, T, C, H, W), not {tuple(frames.shape)}")
        self._check_size(*frames.shape[3:])
        length, layers = frames.shape[1], len(self.channels)
        given = length if given is None else given
        steps = length if steps is None else steps
        error_layers = layers if error_layers is None else error_layers
        if not 1 <= given <= length:
            raise ValueError(f"given is 1 to the {length} frames of the window, not {given}")
        if steps < 1:
            raise ValueError(f"PredNet needs at least one step, not {steps}")
        if not 0 <= error_layers <= layers:
            raise ValueError(f"error_layers is 0 to the network's {layers} layers, not {error_layers}")
        return Plan(min(given, steps), steps, error_layers, self.feedback == "stale")

    def _check_size(self, height: int, width: int) -> None:
        multiple = 2 ** (len(self.channels) - 1)
        if height < 1 or width < 1 or height % multiple or width % multiple:
            raise ValueError(
                f"a PredNet of {len(self.channels)} layers halves its grid {len(self.channels) - 1} times, "
                f"so the sides must be multiples of {multiple}, not {height} x {width}"
            )


def _convolutions(sizes: Sequence[tuple[int, int]]) -> Sequence[nn.Conv2d]:
    modules = (nn.Conv2d(inputs, outputs, 3, padding=1) for inputs, outputs in sizes)
    channels_last = nn.ModuleList(modules).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    return cast("Sequence[nn.Conv2d]", channels_last)


def _copy_keras(convolution: nn.Conv2d, names: Sequence[str], arrays: Mapping[str, NDArray[np.floating]]) -> None:
    for name in names:
        if (shapes := (np.ndim(arrays[f"{name}/kernel"]), np.ndim(arrays[f"{name}/bias"]))) != (4, 1):
            raise ValueError(f"the arrays of {name} have {shapes[0]} and {shapes[1]} axes, not 4 and 1")
    kernel = np.concatenate([arrays[f"{name}/kernel"] for name in names], axis=3).transpose(3, 2, 0, 1)
    bias = np.concatenate([arrays[f"{name}/bias"] for name in names])
    for parameter, array in ((convolution.weight, kernel), (cast(Tensor, convolution.bias), bias)):
        if parameter.shape != array.shape:
            raise ValueError(f"the arrays {', '.join(names)} have shape {array.shape}, not {tuple(parameter.shape)}")
        with torch.no_grad():
            parameter.copy_(torch.from_numpy(np.ascontiguousarray(array)))
