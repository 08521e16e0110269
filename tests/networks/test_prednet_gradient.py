"""The window's written-out backpropagation against autograd over single steps."""

import math
from typing import Literal

import pytest
import torch
from hypothesis import given as given_values
from hypothesis import settings
from hypothesis import strategies as st
from torch import Tensor

from envpred.networks.prednet import PredNet, Unrolled


def network_of(
    channels: tuple[int, ...], feedback: Literal["stale", "current"] = "stale", signed: tuple[int, ...] = ()
) -> PredNet:
    """A float64 network with weights large enough that all activations are met on all their pieces."""
    network = PredNet(channels, feedback, signed).double()
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.copy_(torch.randn(parameter.shape, generator=generator) * (0.4 if parameter.ndim > 1 else 0.2))
    return network


def window(steps: int, channels: int = 2, side: int = 8, batch: int = 2) -> Tensor:
    return torch.rand(
        batch, steps, channels, side, side, generator=torch.Generator().manual_seed(1), dtype=torch.float64
    )


def some_loss(unrolled: Unrolled) -> Tensor:
    """A loss in which every prediction and error has a weight of its own."""
    generator = torch.Generator().manual_seed(2)
    terms = [torch.randn(x.shape, generator=generator, dtype=torch.float64) * x for x in unrolled]
    return terms[0].sum() + 50 * terms[1].sum()


@settings(max_examples=40, deadline=None)
@given_values(
    channels=st.lists(st.integers(1, 4), min_size=1, max_size=3).map(tuple),
    feedback=st.sampled_from(["stale", "current"]),
    signed=st.booleans(),
    given=st.integers(1, 4),
    steps=st.integers(1, 6),
    batch=st.integers(1, 2),
    scale=st.integers(1, 2),
    data=st.data(),
)
def test_window_equals_autograd_over_steps(
    channels: tuple[int, ...],
    feedback: Literal["stale", "current"],
    signed: bool,
    given: int,
    steps: int,
    batch: int,
    scale: int,
    data: st.DataObject,
) -> None:
    error_layers = data.draw(st.integers(0, len(channels)))
    network = network_of(channels, feedback, (channels[0] - 1,) if signed else ())
    side = scale * 2 ** (len(channels) - 1)  # down to one cell in the top layer
    frames = window(4, channels[0], side, batch).requires_grad_()
    fast = network.unroll(frames, given, steps, error_layers)
    plain = network.unroll_by_steps(frames, given, steps, error_layers)
    torch.testing.assert_close(fast, plain, rtol=1e-10, atol=1e-12)
    inputs = [frames, *network.parameters()]
    expected = torch.autograd.grad(some_loss(plain), inputs, allow_unused=True, materialize_grads=True)
    torch.testing.assert_close(torch.autograd.grad(some_loss(fast), inputs), expected, rtol=1e-8, atol=1e-9)


def test_gradients_equal_differences() -> None:
    network, frames = network_of((1, 2)), window(3, channels=1, side=4, batch=1)
    names, parameters = zip(*network.named_parameters(), strict=True)

    def outputs(frames: Tensor, *values: Tensor) -> tuple[Tensor, ...]:
        result = torch.func.functional_call(network, dict(zip(names, values, strict=True)), (frames, 2, 4))
        assert isinstance(result, Tensor)
        return (result,)

    torch.autograd.gradcheck(outputs, (frames.requires_grad_(), *parameters), fast_mode=True)


def test_two_losses_of_one_graph_and_repeated_backward_add_up() -> None:
    network, frames = network_of((2, 3)), window(5)
    parameters = list(network.parameters())
    next_frame, recursive = network.unroll(frames).errors[:, 1:, 0].mean(), network(frames, given=2).square().mean()
    separate = [torch.autograd.grad(loss, parameters, retain_graph=True) for loss in (next_frame, recursive)]
    (2 * next_frame + recursive).backward(retain_graph=True)
    recursive.backward()
    expected = [2 * first + 2 * second for first, second in zip(*separate, strict=True)]
    torch.testing.assert_close([parameter.grad for parameter in parameters], expected)


def test_what_backward_needed_is_released_after_it() -> None:
    loss = network_of((2, 3))(window(4)).sum()
    loss.backward()
    with pytest.raises(RuntimeError, match="second time"):
        loss.backward()


def test_same_numbers_without_gradients() -> None:
    network, frames = network_of((2, 3, 4)), window(5)
    expected = network.unroll(frames, given=3)
    with torch.no_grad():
        unrolled = network.unroll(frames, given=3)
    assert not unrolled.predictions.requires_grad
    torch.testing.assert_close(unrolled, Unrolled(*(x.detach() for x in expected)), rtol=0, atol=0)


def test_same_window_gives_the_same_bits() -> None:
    network, frames = network_of((2, 4, 8)).float(), window(5).float()
    parameters = list(network.parameters())
    first, second = (torch.autograd.grad(network(frames, given=3).mean(), parameters) for _ in range(2))
    assert all(torch.equal(a, b) for a, b in zip(first, second, strict=True))


def test_mixed_precision_stays_near_single() -> None:
    torch.manual_seed(0)
    network, frames = PredNet((2, 8, 16)), window(6, side=16).float()
    parameters = list(network.parameters())
    with torch.no_grad():
        network.get_parameter("predict.0.bias").add_(0.3)  # so that the output is alive

    def gradients(mixed: bool) -> tuple[Unrolled, Tensor]:
        with torch.autocast("cpu", torch.bfloat16, enabled=mixed):
            unrolled = network.unroll(frames, given=4)
        loss = (unrolled.predictions - frames).abs().mean() + unrolled.errors.sum()
        return unrolled, torch.cat([g.flatten() for g in torch.autograd.grad(loss, parameters)])

    single, single_gradient = gradients(mixed=False)
    half, half_gradient = gradients(mixed=True)
    assert half.predictions.dtype == half.errors.dtype == half_gradient.dtype == torch.float32
    assert 0 < (half.predictions - single.predictions).abs().max() < 0.05
    torch.testing.assert_close(half.errors, single.errors, rtol=0.05, atol=0.01)
    cosine = torch.nn.functional.cosine_similarity(half_gradient, single_gradient, dim=0)
    assert math.isclose(cosine.item(), 1, abs_tol=0.02)


@pytest.mark.slow
def test_compilers_get_single_steps_in_one_graph() -> None:
    network, frames = network_of((2, 3)), window(4)
    compiled = torch.compile(network.unroll, backend="aot_eager", fullgraph=True)
    expected, unrolled = network.unroll(frames, 2, 5), compiled(frames, 2, 5)
    torch.testing.assert_close(unrolled, expected)
    parameters = list(network.parameters())
    torch.testing.assert_close(
        torch.autograd.grad(some_loss(unrolled), parameters), torch.autograd.grad(some_loss(expected), parameters)
    )
