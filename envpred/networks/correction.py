"""A correction of a rendered forecast: one U-Net in the fixed frame of the last frame shown, a light head per horizon.

What will be seen depends on the place, so the trunk looks once at all that was seen, as wide as it is known; the head
looks at what was rendered for a horizon, cell by cell, beside the trunk's features of the same places.
"""

from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

FACTOR = 16  # by which sides of the context must divide
RENDERED = 4  # channels that are rendered
LEAST = 0.002  # probabilities are kept this far from 0 and 1 before their logit is taken


class Canvas(NamedTuple):
    """What the trunk looks at, of one window.

    Args:
        channels: (C, H, W), see `context_channels`.
        inside: (H, W) 1 in the judged grid of the last frame shown.
        last: (H, W) a quarter of the logit of its pignistic probability, 0 outside.
    """

    channels: Tensor
    inside: Tensor
    last: Tensor


def context_channels(given: int) -> int:
    """Channels of a canvas: hit and free in each frame, four masses, inside, range, last."""
    return 2 * given + 7


def block(inputs: int, outputs: int, stride: int = 1) -> nn.Sequential:
    """Convolution 3 x 3, group normalisation, ReLU."""
    convolution = nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False)
    return nn.Sequential(convolution, nn.GroupNorm(8, outputs), nn.ReLU(inplace=True))


def up(x: Tensor) -> Tensor:
    """Twice the height and width (..., H, W), nearest."""
    return functional.interpolate(x, scale_factor=2, mode="nearest")


class Trunk(nn.Module):
    """A U-Net (Ronneberger et al. 2015) from half to a sixteenth of the resolution, with a stem at full resolution.

    Args:
        inputs: channels of the context.
        width: channels at half of the resolution, twice as many below.
        fine: channels at full resolution, given out.
    """

    def __init__(self, inputs: int, width: int, fine: int) -> None:
        super().__init__()
        wide = 2 * width
        self.stem = nn.Sequential(nn.Conv2d(inputs, fine, 3, 1, 1), nn.ReLU(inplace=True))
        enter = nn.Conv2d(fine, width, 4, 2, 1, bias=False)
        self.down_2 = nn.Sequential(enter, nn.GroupNorm(8, width), nn.ReLU(inplace=True), block(width, width))
        self.down_4 = nn.Sequential(block(width, wide, 2), block(wide, wide))
        self.down_8 = nn.Sequential(block(wide, wide, 2), block(wide, wide))
        self.down_16 = nn.Sequential(block(wide, wide, 2), block(wide, wide))
        self.up_8, self.up_4, self.up_2 = block(2 * wide, wide), block(2 * wide, width), block(wide, width)
        self.rise = nn.Conv2d(width, 4 * fine, 1)
        self.join = nn.Conv2d(fine, fine, 3, 1, 1)

    def forward(self, context: Tensor) -> Tensor:
        """Features (B, fine, H, W) of a context (B, inputs, H, W), H and W multiples of 16."""
        stem = self.stem(context)
        half = self.down_2(stem)
        quarter = self.down_4(half)
        eighth = self.down_8(quarter)
        eighth = self.up_8(torch.cat([up(self.down_16(eighth)), eighth], 1))
        quarter = self.up_4(torch.cat([up(eighth), quarter], 1))
        half = self.up_2(torch.cat([up(quarter), half], 1))
        whole = functional.relu(stem + functional.pixel_shuffle(self.rise(half), 2))
        features: Tensor = whole + functional.relu(self.join(whole))
        return features


class Cut(torch.autograd.Function):
    """Windows (N, C, n, n) of one map (C, H, W); its gradient fills one array, where slicing would fill N."""

    @staticmethod
    def forward(ctx: Any, maps: Tensor, corners: list[list[int]], n: int) -> Tensor:
        """Copies the windows whose first cells are `corners`, channels last."""
        ctx.corners, ctx.shape, ctx.n = corners, maps.shape, n
        out = maps.new_empty((len(corners), n, n, maps.shape[0])).permute(0, 3, 1, 2)
        for k, (i, j) in enumerate(corners):
            out[k] = maps[:, i : i + n, j : j + n]
        return out

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None, None]:
        """Adds the windows' gradients up where they came from."""
        channels, height, width = ctx.shape
        out = gradients[0].new_zeros((height, width, channels)).permute(2, 0, 1)
        for gradient, (i, j) in zip(gradients[0], ctx.corners, strict=True):
            out[:, i : i + ctx.n, j : j + ctx.n] += gradient
        return out, None, None


class Correction(nn.Module):
    """Corrects a rendered forecast in logits: a pull towards the last frame shown, and a shift.

    Both are zero at the start, so that an untrained network is the rollout itself.

    Args:
        given: frames shown.
        horizons: how many forecasts.
        width: channels of the trunk at half of the resolution; a multiple of 8.
        fine: channels at full resolution.
        head: channels of the head, per cell and horizon.
    """

    def __init__(self, given: int = 5, horizons: int = 15, width: int = 32, fine: int = 16, head: int = 16) -> None:
        super().__init__()
        self.trunk = Trunk(context_channels(given), width, fine)
        self.project = nn.Parameter(torch.randn(horizons, head, fine) / fine**0.5)
        self.enter = nn.Conv2d(RENDERED + 1, head, 3, 1, 1, bias=False)
        self.spread = nn.Linear(2, head)
        self.middle = nn.Conv2d(head, head, 1)
        self.leave = nn.Conv2d(head, 2, 1)
        for parameter in self.leave.parameters():
            nn.init.zeros_(parameter)

    def forward(
        self, canvas: Canvas, rendered: Tensor, corner: list[list[int]], spread: Tensor, which: Tensor
    ) -> Tensor:
        """Probabilities of occupied (N, n, n) of one window.

        Args:
            canvas: what was seen, in the fixed frame of the last frame shown.
            rendered: (N, 4, n, n) m(O), m(F), chances of a hit and of free, in the ego's grid of each horizon.
            corner: N first cells of those grids in the canvas, which they may leave.
            spread: (N, 2) half the standard deviation of the ego's futures, in cells.
            which: (N,) the horizons, 0 is the first.
        """
        n = rendered.shape[-1]
        features = self.trunk(canvas.channels[None].contiguous(memory_format=torch.channels_last))[0]
        known = torch.stack([canvas.inside, canvas.last])
        height, width = features.shape[-2:]
        beyond = max(0, *(max(-i, -j, i + n - height, j + n - width) for i, j in corner))
        if beyond:  # an ego that leaves the canvas: what lies beyond looks like its border
            features = functional.pad(features[None], (beyond,) * 4, mode="replicate")[0]
            known = functional.pad(known, (beyond,) * 4)
            corner = [[i + beyond, j + beyond] for i, j in corner]
        # Without gradients one horizon at a time, which stays in the processor's cache.
        step = len(rendered) if torch.is_grad_enabled() else 1
        parts = [slice(k, k + step) for k in range(0, len(rendered), step)]
        return torch.cat([self._head(features, known, rendered[p], corner[p], spread[p], which[p]) for p in parts])

    def _head(
        self, features: Tensor, known: Tensor, rendered: Tensor, corner: list[list[int]], spread: Tensor, which: Tensor
    ) -> Tensor:
        n = rendered.shape[-1]
        logit = torch.logit(0.5 + 0.5 * (rendered[:, :1] - rendered[:, 1:2]), LEAST)
        inputs = torch.cat([rendered, 0.25 * logit], 1).contiguous(memory_format=torch.channels_last)
        local: Tensor = Cut.apply(features, corner, n)  # type: ignore[no-untyped-call]
        local = local.permute(0, 2, 3, 1).flatten(1, 2)
        seen = torch.baddbmm(self.spread(spread)[:, None], local, self.project[which].transpose(1, 2))
        x = self.enter(inputs) + seen.view(len(rendered), n, n, -1).permute(0, 3, 1, 2)
        x = functional.relu(self.middle(functional.relu(x, inplace=True)), inplace=True)
        pull, shift = self.leave(x).float().unbind(1)
        here = torch.stack([known[:, i : i + n, j : j + n] for i, j in corner])
        forecast = logit[:, 0].float()
        return torch.sigmoid(forecast + pull * here[:, 0] * (4 * here[:, 1] - forecast) + shift)


class WorldCorrection(nn.Module):
    """Corrects the world that is rendered: shifts the logits of its hits, in the fixed frame of the last frame shown.

    The shifts are zero at the start, so that an untrained network leaves the world as it is.

    Args:
        given: frames shown.
        horizons: how many forecasts.
        width: channels of the trunk at half of the resolution; a multiple of 8.
        fine: channels at full resolution.
        head: channels of the head, per cell and horizon.
    """

    def __init__(self, given: int = 5, horizons: int = 15, width: int = 32, fine: int = 16, head: int = 16) -> None:
        super().__init__()
        self.trunk = Trunk(context_channels(given), width, fine)
        self.project = nn.Parameter(torch.randn(horizons, fine, head) / fine**0.5)
        self.enter = nn.Linear(1, head)
        self.middle = nn.Linear(head, head)
        self.leave = nn.Linear(head, 1)
        for parameter in self.leave.parameters():
            nn.init.zeros_(parameter)

    def forward(self, channels: Tensor, hit: Tensor, corner: tuple[int, int], trust: float = 1.0) -> Tensor:
        """Probabilities of a hit (N, I, J), corrected.

        Args:
            channels: (C, H, W) what was seen, see `context_channels`.
            hit: (N, I, J) probabilities of a hit, horizon by horizon.
            corner: first cell of `hit` among the channels.
            trust: factor on the shifts.
        """
        features = self.trunk(channels[None].contiguous(memory_format=torch.channels_last))[0]
        rows, columns = hit.shape[1:]
        window = features[:, corner[0] : corner[0] + rows, corner[1] : corner[1] + columns]
        local = window.permute(1, 2, 0).flatten(0, 1)
        # One horizon at a time, which stays in the processor's cache.
        corrected = [self._head(local, h, p, trust) for h, p in zip(hit.flatten(1), self.project, strict=False)]
        return torch.stack(corrected).view_as(hit)

    def _head(self, local: Tensor, hit: Tensor, project: Tensor, trust: float) -> Tensor:
        """Chances (M,) of a hit in cells that have the features `local` (M, fine) and were given the chances `hit`."""
        logit = 0.25 * torch.logit(hit, LEAST)
        x = torch.addmm(self.enter.bias, local, project).addcmul_(logit[:, None], self.enter.weight[:, 0])
        x = functional.relu(self.middle(functional.relu(x, inplace=True)), inplace=True)
        shift = trust * self.leave(x).float()[:, 0].clamp(-8, 8)
        odds = hit * shift.exp()
        chances: Tensor = odds / (1 - hit + odds)
        return chances
