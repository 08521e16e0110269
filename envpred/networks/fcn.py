"""FCN-8s (Long, Shelhamer, Darrell 2015) with a VGG-16 trunk, as a regressor of probabilities."""

import torch
from torch import Tensor, nn
from torch.nn import functional

# VGG-16 (Simonyan and Zisserman 2015, configuration D): convolutions of each block, its channels at full width.
BLOCKS = ((2, 64), (2, 128), (3, 256), (3, 512), (3, 512))
HIDDEN = 4096  # VGG's fully connected layers, here convolutions
STRIDE = 2 ** len(BLOCKS)  # cells of the grid per cell of the coarsest map


class FCN8s(nn.Module):
    """One grid of `channels` channels in, `outputs` maps of probability out, each in [0, 1].

    `width` scales the channels of the trunk (1: VGG-16, 134 million parameters); `dropout` is VGG's.  Unlike the
    original the trunk starts from He's initialisation instead of ImageNet's weights, whose first layer expects colour,
    and every convolution pads its own border instead of the input being padded by a hundred cells and cropped.
    """

    def __init__(self, channels: int, outputs: int, width: float = 1.0, dropout: float = 0.5) -> None:
        super().__init__()
        if channels < 1 or outputs < 1 or not width > 0:
            raise ValueError(
                f"FCN-8s needs input channels, outputs and a width above 0, not {channels}, {outputs}, {width}"
            )
        self.channels, self.outputs = channels, outputs
        sizes = [max(1, round(size * width)) for _, size in BLOCKS]
        hidden = max(1, round(HIDDEN * width))
        self.blocks = nn.ModuleList(
            _block(before, size, count)
            for before, size, (count, _) in zip([channels, *sizes[:-1]], sizes, BLOCKS, strict=True)
        )
        self.head = nn.Sequential(
            nn.Conv2d(sizes[4], hidden, 7, padding=3),
            nn.ReLU(inplace=True),
            nn.Dropout(dropout),
            nn.Conv2d(hidden, hidden, 1),
            nn.ReLU(inplace=True),
            nn.Dropout(dropout),
        )
        self.score_head = nn.Conv2d(hidden, outputs, 1)
        self.score_pool4 = nn.Conv2d(sizes[3], outputs, 1)
        self.score_pool3 = nn.Conv2d(sizes[2], outputs, 1)
        self.upsample_head = nn.ConvTranspose2d(outputs, outputs, 4, stride=2, padding=1, bias=False)
        self.upsample_pool4 = nn.ConvTranspose2d(outputs, outputs, 4, stride=2, padding=1, bias=False)
        self.reset_parameters()
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # what CPU and GPU kernels like best

    def reset_parameters(self) -> None:
        """He's initialisation in the trunk, zero scores as in the paper, bilinear upsampling; the output starts at 0.5.

        From there, the probability of a cell without evidence, the first steps meet neither bound.
        """
        for module in (*self.blocks.modules(), *self.head.modules()):
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
                assert module.bias is not None
                nn.init.zeros_(module.bias)
        for score in (self.score_head, self.score_pool4, self.score_pool3):
            nn.init.zeros_(score.weight)
            assert score.bias is not None
            nn.init.constant_(score.bias, 0.5 if score is self.score_pool3 else 0.0)
        for upsample in (self.upsample_head, self.upsample_pool4):
            with torch.no_grad():
                upsample.weight.copy_(_bilinear(self.outputs))

    def forward(self, grid: Tensor) -> Tensor:
        """Probabilities (B, outputs, H, W) from a `grid` (B, channels, H, W) whose sides are multiples of 32."""
        if grid.ndim != 4 or grid.shape[1] != self.channels:
            raise ValueError(f"an FCN-8s of {self.channels} channels reads (B, C, H, W), not {tuple(grid.shape)}")
        if grid.shape[2] % STRIDE or grid.shape[3] % STRIDE:
            raise ValueError(
                f"FCN-8s halves its grid {len(BLOCKS)} times, "
                f"so the sides must be multiples of {STRIDE}, not {grid.shape[2]} x {grid.shape[3]}"
            )
        value = grid.contiguous(memory_format=torch.channels_last)
        pools = []
        for block in self.blocks:
            value = block(value)
            pools.append(value)
        value = self.upsample_head(self.score_head(self.head(value)))
        value = self.upsample_pool4(value + self.score_pool4(pools[3]))
        value = value + self.score_pool3(pools[2])
        # The paper's fixed bilinear kernel, but for the border, where that fades to zero and this holds the edge.
        value = functional.interpolate(value, scale_factor=8, mode="bilinear", align_corners=False)
        return clamp_alive(value)


def clamp_alive(value: Tensor) -> Tensor:
    """`value` clamped to [0, 1] with the gradient of the identity.

    The plain clamp's gradient is zero outside the range, so a cell once pushed out would never be corrected.  Towards
    targets within [0, 1] the loss's gradient points inwards or is zero at a bound: nothing is driven further out.
    """
    return value.clamp(0, 1).detach() + (value - value.detach())


def _block(before: int, size: int, count: int) -> nn.Sequential:
    """`count` convolutions to `size` channels, then a halving."""
    layers: list[nn.Module] = []
    for k in range(count):
        layers += [nn.Conv2d(before if k == 0 else size, size, 3, padding=1), nn.ReLU(inplace=True)]
    return nn.Sequential(*layers, nn.MaxPool2d(2))


def _bilinear(outputs: int) -> Tensor:
    """The kernel (outputs, outputs, 4, 4) that doubles each map by itself, bilinearly."""
    line = torch.tensor([0.25, 0.75, 0.75, 0.25])
    return torch.eye(outputs)[:, :, None, None] * torch.outer(line, line)
