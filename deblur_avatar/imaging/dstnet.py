"""DSTNet, small: a recurrent network that sharpens the frames of a blurred video.

Conventions. A clip is [B, T, D, H, W]: B clips of T frames, D = 4 layers in [0, 1], sRGB and the
matte, which are blurred together. C features; bands are at a half (H / 2) and a quarter of the
size. Heights and widths are multiples of `MULTIPLE`.

Frames become features, and features Haar bands. In the lowest band, blocks weigh channels against
each other by filters that depend on the frame (discriminative temporal feature aggregation along
channels). Then two passes, first against time and then along it, fuse each frame's features with
those that come from its neighbour, by gates and by filters of every pixel's own, so that what helps
is taken over and what does not is left (the same along space). What is added to the frames is read
from both bands.

Source: Pan et al., "Deep discriminative spatial and temporal network for efficient video
deblurring", CVPR 2023 (DSTNet), made small: docs/decisions/0043.
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from deblur_avatar.config.section import Count, Params
from deblur_avatar.imaging.dynamic_filters import (
    MIDDLE,
    TAPS,
    filter_by_channel,
    filter_by_pixel,
)
from deblur_avatar.imaging.haar import haar, inverse_haar

LAYERS = 4  # red, green, blue, coverage
MULTIPLE = 16  # half the size is pooled by 4 and by 2
SLOPE = 0.1  # of leaky rectifiers below 0
EXPANSION = 2  # channels of each half of an aggregation block, in units of C
LARGEST = 256  # features, blocks or refinements that no network of ours has


class DstnetParams(Params):
    """How large the network is; the published one has 64, 15 and 15."""

    features: Count
    blocks: Count  # of aggregation along channels
    refinements: Count  # residual blocks after each fusion


class Residual(nn.Sequential):
    """A residual block: two convolutions whose result is added."""

    def __init__(self, channels: int, groups: int = 1) -> None:
        super().__init__(
            nn.Conv2d(channels, channels, 3, padding=1, groups=groups),
            nn.LeakyReLU(SLOPE),
            nn.Conv2d(channels, channels, 3, padding=1, groups=groups),
        )

    def forward(self, features: Float[Tensor, "F C H W"]) -> Float[Tensor, "F C H W"]:
        """Add what was found."""
        return features + super().forward(features)


class ChannelAggregation(nn.Module):
    """Aggregation along channels: one half of the features, filtered as the frame asks for, weighs
    the other.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        wide = EXPANSION * channels
        self.norm = nn.LayerNorm(channels)
        self.widen = nn.Conv3d(channels, 2 * wide, (3, 1, 1), padding=(1, 0, 0))
        asks = nn.Conv2d(wide, (TAPS + 1) * wide, 1)
        self.taps = nn.Sequential(
            nn.AvgPool2d(2),
            nn.Conv2d(wide, wide, 3, padding=1, groups=wide),
            nn.LeakyReLU(SLOPE),
            nn.MaxPool2d(2),
            nn.Conv2d(wide, wide, 3, padding=1, groups=wide),
            nn.LeakyReLU(SLOPE),
            nn.AdaptiveAvgPool2d(1),
            asks,
        )
        self.narrow = nn.Conv3d(wide, channels, (3, 1, 1), padding=(1, 0, 0))
        _begin_as_identity(asks, wide, TAPS + 1)

    def forward(self, band: Float[Tensor, "B T C H W"]) -> Float[Tensor, "B T C H W"]:
        """Aggregate over channels, and over frames next to each other."""
        normed = self.norm(band.movedim(2, -1)).movedim(-1, 1)  # [B, C, T, H, W]
        wide = self.widen(normed).movedim(1, 2).flatten(0, 1)
        asked, weighed = wide.chunk(2, 1)
        taps, bias = self.taps(asked).view(*asked.shape[:2], -1).split((TAPS, 1), -1)
        gated = (filter_by_channel(asked, taps) + bias[..., None]) * weighed
        gated = gated.unflatten(0, band.shape[:2]).movedim(2, 1)
        return band + self.narrow(gated).movedim(1, 2)


class Fusion(nn.Module):
    """Discriminative fusion of one frame's features with those that come from its neighbour."""

    def __init__(self, channels: int, refinements: int) -> None:
        super().__init__()
        self.mix = nn.Conv2d(2 * channels, 2 * channels, 3, padding=1)
        self.gate = nn.Conv2d(2 * channels, 2 * channels, 3, padding=1, groups=2)
        asks = nn.Conv2d(channels, TAPS * channels, 1)
        self.taps = nn.Sequential(
            nn.AvgPool2d(4),
            Residual(channels),
            nn.MaxPool2d(2),
            Residual(channels),
            asks,
            nn.Upsample(scale_factor=8, mode="bilinear", align_corners=False),
        )
        self.refine = nn.Sequential(*(Residual(channels) for _ in range(refinements)))
        _begin_as_identity(asks, channels, TAPS)

    def forward(
        self, own: Float[Tensor, "B C H W"], carried: Float[Tensor, "B C H W"]
    ) -> Float[Tensor, "B C H W"]:
        """What is known of the frame, and goes on to the next."""
        mixed = functional.leaky_relu(self.mix(torch.cat([own, carried], 1)), SLOPE)
        first, second = (mixed * self.gate(mixed).sigmoid()).chunk(2, 1)
        fused = first + second
        taps = self.taps(fused).unflatten(1, (fused.shape[1], TAPS))
        refined: Tensor = self.refine(filter_by_pixel(fused, taps))
        return refined


class Dstnet(nn.Module):
    """The network; untrained, it changes nothing."""

    def __init__(self, params: DstnetParams) -> None:
        super().__init__()
        channels = params.features
        self.enter = nn.Conv2d(LAYERS, channels, 3, padding=1)
        self.high = nn.Sequential(
            nn.Conv2d(3 * channels, 3 * channels, 1, groups=3),
            nn.LeakyReLU(SLOPE),
            nn.Conv2d(3 * channels, 3 * channels, 1, groups=3),
        )
        self.aggregate = nn.Sequential(
            *(ChannelAggregation(channels) for _ in range(params.blocks))
        )
        self.against_time = Fusion(channels, params.refinements)
        self.along_time = Fusion(channels, params.refinements)
        self.leave = nn.Conv2d(channels, LAYERS, 3, padding=1)
        for parameter in self.leave.parameters():
            nn.init.zeros_(parameter)

    def forward(self, clip: Float[Tensor, "B T D H W"]) -> Float[Tensor, "B T D H W"]:
        """Sharpen all frames of each clip; values may leave [0, 1]."""
        shape = clip.shape[:2]
        half, half_high = haar(self.enter(clip.flatten(0, 1)))
        quarter, quarter_high = haar(half)
        quarter = self.aggregate(quarter.unflatten(0, shape)).flatten(0, 1)
        half = inverse_haar(quarter, quarter_high).unflatten(0, shape)
        half = _passed(self.against_time, half.flip(1)).flip(1)
        half = _passed(self.along_time, half)
        features = inverse_haar(half.flatten(0, 1), self.high(half_high))
        return clip + self.leave(features).unflatten(0, shape)


def restore(network: Dstnet, clip: Float[Tensor, "T D H W"]) -> Float[Tensor, "T D H W"]:
    """Sharpen one clip of any size, without gradients.

    It goes on beyond its lower and right edges as it ends there, up to a size that can be halved.

    Returns:
        Values in [0, 1].
    """
    height, width = clip.shape[-2:]
    pad = (0, -width % MULTIPLE, 0, -height % MULTIPLE)
    with torch.no_grad():
        whole = functional.pad(clip, pad, mode="replicate")
        restored: Tensor = network(whole[None])[0, ..., :height, :width]
    return restored.clamp(0, 1)


def _passed(fusion: Fusion, band: Float[Tensor, "B T C H W"]) -> Float[Tensor, "B T C H W"]:
    """Fuse frame after frame; nothing comes to the first."""
    carried, passed = torch.zeros_like(band[:, 0]), []
    for own in band.unbind(1):
        carried = fusion(own, carried)
        passed.append(carried)
    return torch.stack(passed, 1)


def _begin_as_identity(predicts: nn.Conv2d, channels: int, numbers: int) -> None:
    """Have a predictor of kernels begin with those that leave a picture as it is."""
    with torch.no_grad():
        predicts.weight.mul_(0.1)
        bias = torch.zeros(channels, numbers)
        bias[:, MIDDLE] = 1
        assert predicts.bias is not None
        predicts.bias.copy_(bias.flatten())
