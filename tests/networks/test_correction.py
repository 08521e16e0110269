"""The network of the correction: zero at the start, gradients of its windows, and places outside the canvas."""

import math

import torch

from envpred.networks.correction import Canvas, Correction, Cut, WorldCorrection, context_channels


def inputs(n: int = 16, side: int = 32, horizons: int = 3) -> tuple[Canvas, torch.Tensor, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    channels = torch.rand(context_channels(2), side, side, generator=generator)
    masses = torch.rand(horizons, 4, n, n, generator=generator) / 2
    canvas = Canvas(channels, torch.ones(side, side), torch.zeros(side, side))
    return canvas, masses, torch.rand(horizons, 2, generator=generator), torch.arange(horizons)


def test_untrained_it_leaves_what_is_rendered() -> None:
    canvas, masses, spread, which = inputs()
    network = Correction(given=2, horizons=3, width=8, fine=8, head=8)
    found = network(canvas, masses, [[0, 0], [5, 9], [16, 16]], spread, which)
    torch.testing.assert_close(found, 0.5 + 0.5 * (masses[:, 0] - masses[:, 1]))


def test_grids_beyond_the_canvas_see_its_border() -> None:
    canvas, masses, spread, which = inputs()
    network = Correction(given=2, horizons=3, width=8, fine=8, head=8)
    torch.nn.init.normal_(network.leave.weight, std=0.5)
    far = network(canvas, masses, [[-20, 0], [5, 40], [0, 0]], spread, which)
    near = network(canvas, masses, [[0, 0], [5, 9], [0, 0]], spread, which)
    assert torch.isfinite(far).all()
    torch.testing.assert_close(far[2], near[2])


def test_one_horizon_at_a_time_is_the_same() -> None:
    """Without gradients the head takes one horizon after the other."""
    canvas, masses, spread, which = inputs()
    network = Correction(given=2, horizons=3, width=8, fine=8, head=8)
    torch.nn.init.normal_(network.leave.weight, std=0.5)
    corners = [[0, 0], [5, 9], [16, 16]]
    together = network(canvas, masses, corners, spread, which)
    with torch.no_grad():
        torch.testing.assert_close(network(canvas, masses, corners, spread, which), together, rtol=1e-5, atol=1e-6)


def test_gradients_go_where_windows_came_from() -> None:
    maps = torch.rand(2, 6, 6, dtype=torch.double, requires_grad=True)
    assert torch.autograd.gradcheck(lambda m: Cut.apply(m, [[0, 1], [2, 2]], 3), maps)  # type: ignore[no-untyped-call]


def test_a_corrected_world_starts_as_it_was_and_shifts_its_odds() -> None:
    """Zero at the start; a shift of 1 in logits that is trusted by half multiplies the odds by exp(0.5)."""
    torch.manual_seed(0)
    network = WorldCorrection(given=3, horizons=4, width=8, fine=8, head=8)
    channels, hit = torch.rand(context_channels(3), 32, 48), torch.rand(4, 20, 30)
    hit[:, :2] = torch.tensor([0.0, 1.0]).repeat(15)
    torch.testing.assert_close(network(channels, hit, (5, 9)), hit)
    torch.nn.init.ones_(network.leave.bias)
    found = network(channels, hit, (5, 9), trust=0.5)
    inner = slice(2, None)
    odds = hit[:, inner] / (1 - hit[:, inner])
    torch.testing.assert_close(found[:, inner] / (1 - found[:, inner]), odds * math.exp(0.5), rtol=1e-3, atol=1e-3)
    torch.testing.assert_close(found[:, :2], hit[:, :2], msg="what is certain stays so")


def test_a_corrected_world_looks_at_the_place_of_its_cells() -> None:
    """Shifted channels and a corner shifted alike make the same world, far from the borders."""
    torch.manual_seed(0)
    network = WorldCorrection(given=3, horizons=2, width=8, fine=8, head=8)
    torch.nn.init.normal_(network.leave.weight)
    channels, hit = torch.rand(context_channels(3), 96, 96), torch.rand(2, 8, 8)
    before, after = network(channels, hit, (40, 40)), network(channels.roll((16, 16), (1, 2)), hit, (56, 56))
    assert (before - hit).abs().max() > 0.05
    assert (before - after).abs().mean() < 0.02, "but for group normalisation, which sees the rolled border"


def test_a_world_is_corrected_alike_with_and_without_gradients() -> None:
    """One of the horizons has no cell that may be hit."""
    torch.manual_seed(0)
    network = WorldCorrection(given=3, horizons=3, width=8, fine=8, head=8)
    torch.nn.init.normal_(network.leave.weight)
    channels, hit = torch.rand(context_channels(3), 32, 48), torch.zeros(3, 20, 30)
    hit[0, 3:9, 5:22], hit[1, :, 29] = torch.rand(6, 17), torch.rand(20)
    whole = network(channels, hit, (5, 9))
    with torch.no_grad():
        again = network(channels, hit, (5, 9))
    torch.testing.assert_close(again, whole)
    assert (whole[0] - hit[0]).abs().max() > 0.05
