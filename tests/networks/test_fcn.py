"""FCN-8s: shapes, size, gradients, bounds."""

import pytest
import torch
from torch import Tensor, nn
from torch.nn import functional

from envpred.networks.fcn import FCN8s, clamp_alive


def grid(batch: int = 2, channels: int = 3, height: int = 64, width: int = 32) -> Tensor:
    return torch.rand(batch, channels, height, width, generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize(("channels", "outputs"), [(3, 4), (1, 15)])
def test_shape_and_range(channels: int, outputs: int) -> None:
    torch.manual_seed(0)
    network = FCN8s(channels, outputs, width=1 / 32)
    with torch.no_grad():
        for score in (network.score_head, network.score_pool4, network.score_pool3):
            score.weight.normal_(std=5)
        forecast = network(grid(channels=channels))
    assert forecast.shape == (2, outputs, 64, 32)
    assert forecast.min() == 0
    assert forecast.max() == 1


def test_parameters_at_full_width() -> None:
    with torch.device("meta"):
        network = FCN8s(3, 4)
    vgg16 = 138_357_544 - (4096 * 1000 + 1000)  # as published, without its classifier
    scores = (4096 + 1) * 4 + (512 + 1) * 4 + (256 + 1) * 4
    upsampling = 2 * 4 * 4 * 4 * 4
    assert sum(p.numel() for p in network.parameters()) == vgg16 + scores + upsampling


def test_starts_at_even_odds() -> None:
    torch.testing.assert_close(FCN8s(1, 3, 1 / 32)(grid(channels=1)), torch.full((2, 3, 64, 32), 0.5))


def test_every_parameter_learns() -> None:
    torch.manual_seed(0)
    network = FCN8s(3, 2, width=1 / 16)
    optimiser = torch.optim.SGD(network.parameters(), lr=0.05)
    target = (grid(channels=2) > 0.7).float()
    for _ in range(2):  # the scores start at zero, so what lies below them is reached by the second step
        optimiser.zero_grad()
        torch.autograd.backward(functional.l1_loss(network(grid()), target))
        optimiser.step()
    for name, parameter in network.named_parameters():
        assert parameter.grad is not None
        assert parameter.grad.abs().sum() > 0, name


def test_learns_a_simple_scene() -> None:
    torch.manual_seed(0)
    network = FCN8s(1, 2, width=1 / 16, dropout=0.0)
    optimiser = torch.optim.Adam(network.parameters(), lr=2e-3)
    scene = torch.zeros(4, 1, 32, 32)
    for n in range(4):
        scene[n, 0, 8 * n : 8 * n + 8, 8:24] = 1.0
    target = torch.cat([scene, 1 - scene], dim=1)
    losses = []
    for _ in range(60):
        optimiser.zero_grad()
        loss = functional.l1_loss(network(scene), target)
        torch.autograd.backward(loss)
        optimiser.step()
        losses.append(loss.item())
    assert losses[-1] < 0.4 * losses[0]


def test_upsampling_starts_bilinear() -> None:
    network = FCN8s(1, 2, 1 / 32)
    coarse = torch.rand(1, 2, 5, 6, generator=torch.Generator().manual_seed(1))
    expected = functional.interpolate(coarse, scale_factor=2, mode="bilinear", align_corners=False)
    for upsample in (network.upsample_head, network.upsample_pool4):
        torch.testing.assert_close(upsample(coarse)[..., 1:-1, 1:-1], expected[..., 1:-1, 1:-1])


def test_what_was_clamped_comes_back() -> None:
    value = nn.Parameter(torch.tensor([-0.5, 1.5, -0.5, 1.5, 0.3]))
    target = torch.tensor([0.0, 1.0, 0.4, 0.6, 0.8])
    optimiser = torch.optim.SGD([value], lr=0.05)
    for _ in range(100):
        optimiser.zero_grad()
        torch.autograd.backward((clamp_alive(value) - target).abs().sum())
        optimiser.step()
    torch.testing.assert_close(clamp_alive(value), target, rtol=0, atol=0.06)
    assert value[:2].tolist() == [-0.5, 1.5]  # already right: nothing drives it


def test_clamps_exactly() -> None:
    value = torch.tensor([-0.1, 0.0, 0.1234567, 1.0, 1.1])
    assert torch.equal(clamp_alive(value), value.clamp(0, 1))


def test_translation_by_the_coarsest_cell() -> None:
    """Far from the border the network is convolutional: a scene moved by 32 cells gives the forecast moved by 32."""
    torch.manual_seed(0)
    network = FCN8s(1, 2, 1 / 32, dropout=0.0).eval()
    with torch.no_grad():
        for score in (network.score_head, network.score_pool4, network.score_pool3):
            score.weight.normal_(std=0.05)
        scene = torch.zeros(1, 1, 32, 544)
        scene[..., 256:288] = grid(1, 1, 32, 32)
        one, two = network(scene), network(scene.roll(32, dims=3))
    assert one[..., 200:340].std() > 0
    torch.testing.assert_close(one[..., 200:340], two[..., 232:372], rtol=0, atol=1e-5)


def test_misuse_is_refused() -> None:
    network = FCN8s(1, 1, 1 / 64)
    with pytest.raises(ValueError, match="multiples of 32, not 40 x 32"):
        network(torch.zeros(1, 1, 40, 32))
    with pytest.raises(ValueError, match=r"reads \(B, C, H, W\)"):
        network(torch.zeros(1, 2, 32, 32))
    with pytest.raises(ValueError, match="width above 0"):
        FCN8s(1, 1, 0.0)
