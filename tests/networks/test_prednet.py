import math
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from envpred.networks.prednet import PredNet

Arrays = dict[str, NDArray[np.float32]]


@pytest.fixture(scope="module")
def keras(shared: Path) -> Arrays:
    """Weights, input and output of the original Keras class, two channels."""
    with np.load(shared / "reference" / "prednet_keras_c2.npz") as file:
        return dict(file)


def small(
    channels: tuple[int, ...] = (2, 3, 5),
    feedback: Literal["stale", "current"] = "stale",
    signed: tuple[int, ...] = (),
    seed: int = 0,
) -> PredNet:
    """A float64 network with weights large enough that all parts matter."""
    torch.manual_seed(seed)
    network = PredNet(channels, feedback, signed).double()
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.copy_(torch.randn_like(parameter) * (0.4 if parameter.ndim > 1 else 0.2))
    return network


def window(steps: int = 4, channels: int = 2, side: int = 8, batch: int = 2, seed: int = 1) -> Tensor:
    return torch.rand(
        batch, steps, channels, side, side, generator=torch.Generator().manual_seed(seed), dtype=torch.float64
    )


@pytest.mark.parametrize(("run", "given"), [("t1", None), ("t5", 5)])
@pytest.mark.parametrize(
    ("dtype", "tolerance", "error_tolerance"), [(torch.float64, 1e-6, 1e-6), (torch.float32, 2e-4, 2e-6)]
)
def test_equals_the_original_keras_layer(
    keras: Arrays, run: str, given: int | None, dtype: torch.dtype, tolerance: float, error_tolerance: float
) -> None:
    network = PredNet.from_keras(keras).to(dtype)
    frames = torch.from_numpy(keras["frames"]).to(dtype).permute(0, 1, 4, 2, 3)
    predictions, errors = network.unroll(frames, given)
    reference = torch.from_numpy(keras[f"prediction_{run}"]).to(dtype).permute(0, 1, 4, 2, 3)
    torch.testing.assert_close(predictions, reference, rtol=0, atol=tolerance)
    torch.testing.assert_close(errors, torch.from_numpy(keras[f"errors_{run}"]).to(dtype), rtol=0, atol=error_tolerance)


def test_current_feedback_is_another_model(keras: Arrays) -> None:
    frames = torch.from_numpy(keras["frames"]).double().permute(0, 1, 4, 2, 3)
    predictions, errors = PredNet.from_keras(keras, feedback="current").double().unroll(frames, 5)
    reference = torch.from_numpy(keras["prediction_t5"]).double().permute(0, 1, 4, 2, 3)
    torch.testing.assert_close(predictions[:, :6], reference[:, :6], rtol=0, atol=1e-6)
    assert (predictions - reference)[:, 5:].abs().mean().item() == pytest.approx(0.05, abs=0.01)
    assert errors[:, 5:, 0].abs().max() == 0


def test_has_the_papers_number_of_parameters() -> None:
    assert sum(parameter.numel() for parameter in PredNet((4, 48, 96, 192)).parameters()) == 6_919_364


@pytest.mark.parametrize("feedback", ["stale", "current"])
def test_window_equals_repeated_steps(feedback: Literal["stale", "current"]) -> None:
    network, frames = small(feedback=feedback), window(6)
    predictions = network(frames, given=4, steps=9)
    state = network.initial_state(2, 8, 8)
    for t in range(9):
        torch.testing.assert_close(predictions[:, t], state.prediction, rtol=0, atol=1e-12)
        forecast, state = network.step(frames[:, t] if t < 4 else None, state)
        assert forecast is state.prediction


def test_rollouts_leave_the_state_as_it_was() -> None:
    network, frames = small(), window(4)
    state = network.initial_state(2, 8, 8)
    for t in range(3):
        _, state = network.step(frames[:, t], state)

    def rollout() -> Tensor:
        rolled, forecasts = state, [state.prediction]
        for _ in range(4):
            forecast, rolled = network.step(None, rolled)
            forecasts.append(forecast)
        return torch.stack(forecasts, 1)

    first = rollout()
    assert torch.equal(first, rollout())
    torch.testing.assert_close(first, network(frames, given=3, steps=8)[:, 3:], rtol=0, atol=1e-12)


def test_frames_not_shown_do_not_matter() -> None:
    network, frames = small(), window(6)
    other = frames.clone()
    other[:, 3:] = 0.5
    assert torch.equal(network(frames, given=3), network(other, given=3))
    assert not torch.equal(network(frames, given=4), network(other, given=4))


def test_prediction_is_made_before_its_frame_is_seen() -> None:
    network, frames = small(), window(5).requires_grad_()
    (gradient,) = torch.autograd.grad(network(frames)[:, 3].sum(), frames)
    assert gradient[:, 2].abs().sum() > 0
    assert gradient[:, 3:].abs().sum() == 0


def test_longer_horizons_continue_the_shorter() -> None:
    network, frames = small(), window(3)
    assert network(frames, steps=8).shape == (2, 8, 2, 8, 8)
    torch.testing.assert_close(network(frames, steps=8)[:, :3], network(frames))
    assert network(frames, steps=2).shape[1] == 2


def test_errors_of_few_layers_are_the_first_of_all() -> None:
    network, frames = small(), window(4)
    every = network.unroll(frames, given=2)
    assert every.errors.shape == (2, 4, 3)
    for layers in range(3):
        some = network.unroll(frames, given=2, error_layers=layers)
        torch.testing.assert_close(some.errors, every.errors[..., :layers])
        torch.testing.assert_close(some.predictions, every.predictions)


def test_lowest_error_is_half_the_mean_distance_of_prediction_and_frame() -> None:
    network, frames = small(), window(4)
    predictions, errors = network.unroll(frames)
    torch.testing.assert_close(errors[..., 0], 0.5 * (predictions - frames).abs().mean(dim=(2, 3, 4)))


def test_gradient_flows_through_predictions_that_are_fed_back() -> None:
    network, frames = small(channels=(1, 2)), window(2, channels=1, side=4, batch=1).requires_grad_()
    torch.autograd.gradcheck(lambda x: network(x, given=2, steps=5)[:, 4], frames)


def test_signed_channels_reach_minus_one_and_others_stay_in_zero_to_one() -> None:
    network = small(signed=(1,))
    with torch.no_grad():
        network.predict[0].weight.mul_(20)
    predictions = network(window(6) * 2 - 1)
    assert predictions[:, :, 0].min() == 0
    assert predictions[:, :, 1].min() == -1
    assert predictions.amax(dim=(0, 1, 3, 4)).tolist() == [1, 1]


def test_kernels_start_as_in_keras_and_biases_at_zero() -> None:
    torch.manual_seed(0)
    network = PredNet((2, 16, 32))
    for layer, inputs in ((0, 2 + 4 + 16), (1, 16 + 32 + 32), (2, 32 + 64)):
        limit = math.sqrt(6 / (9 * inputs + 9 * network.channels[layer]))  # Glorot uniform of one gate
        for kernel in network.gates[layer].weight.chunk(4):
            assert 0.95 * limit < kernel.abs().max() <= limit
    assert all(parameter.abs().max() == 0 for name, parameter in network.named_parameters() if name.endswith("bias"))


def test_refuses_what_does_not_fit(keras: Arrays) -> None:
    network = small()
    with pytest.raises(ValueError, match=r"multiples of 4, not 8 x 6"):
        network(torch.zeros(1, 2, 2, 8, 6))
    with pytest.raises(ValueError, match=r"multiples of 4, not 6 x 8"):
        network.initial_state(1, 6, 8)
    with pytest.raises(ValueError, match=r"2 channels reads .* not \(1, 2, 3, 8, 8\)"):
        network(torch.zeros(1, 2, 3, 8, 8))
    for given in (0, 3):
        with pytest.raises(ValueError, match=f"given is 1 to the 2 frames of the window, not {given}"):
            network(torch.zeros(1, 2, 2, 8, 8).double(), given=given)
    with pytest.raises(ValueError, match="at least one step"):
        network(torch.zeros(1, 2, 2, 8, 8), steps=0)
    with pytest.raises(ValueError, match="at least one layer"):
        PredNet(())
    with pytest.raises(ValueError, match="not among the 2 input channels"):
        PredNet((2, 3), signed_channels=(2,))
    with pytest.raises(ValueError, match="'stale' or 'current'"):
        PredNet((2, 3), feedback="fresh")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="needs the array 'f_1/kernel'"):
        PredNet.from_keras({name: array for name, array in keras.items() if name != "f_1/kernel"})
    with pytest.raises(ValueError, match=r"a_0 have shape \(8, 4, 3, 2\), not \(8, 4, 3, 3\)"):
        PredNet.from_keras(keras | {"a_0/kernel": keras["a_0/kernel"][:, :2]})
    with pytest.raises(ValueError, match=r"arrays of ahat_0 have 4 and 2 axes"):
        PredNet.from_keras(keras | {"ahat_0/bias": keras["ahat_0/bias"][None]})
