"""LPIPS with VGG16: the distance of two pictures in the features of a trained network.

The trunk is VGG16 up to its last rectified convolution, with ImageNet weights; the heads weigh its
channels. Neither file is shipped: `DEBLUR_AVATAR_LPIPS_WEIGHTS` names torchvision's VGG16
(`vgg16-397923af.pth`), `DEBLUR_AVATAR_LPIPS_HEADS` the published linear heads
(`lpips/weights/v0.1/vgg.pth` of github.com/richzhang/PerceptualSimilarity). Without both the metric
is not measured; it is never computed with other weights.

Source: Zhang et al., "The unreasonable effectiveness of deep features as a perceptual metric", CVPR
2018, version 0.1 with the VGG16 trunk.
"""

import logging
import os
from functools import cache
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor, nn

from deblur_avatar.errors import ArtifactError, ConfigError
from deblur_avatar.readers.weights_files import load_pth

logger = logging.getLogger(__name__)

WEIGHTS_VARIABLE = "DEBLUR_AVATAR_LPIPS_WEIGHTS"
HEADS_VARIABLE = "DEBLUR_AVATAR_LPIPS_HEADS"
STAGES = ((64, 64), (128, 128), (256, 256, 256), (512, 512, 512), (512, 512, 512))  # channels
SMALLEST_SIDE = 2 ** (len(STAGES) - 1)  # pixels
# ImageNet's mean and standard deviation for images in [-1, 1], as the heads were trained with.
SHIFT, SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)
NORM_FLOOR = 1e-10  # as the published code has it
# Of the two files named above; of the trunk's its publisher gives the beginning, in its name.
WEIGHTS_SHA256 = "397923af8e79cdbb6a7127f12361acd7a2f83e06b05044ddf496e83de57a5bf0"
HEADS_SHA256 = "a78928a0af1e5f0fcb1f3b9e8f8c3a2a5a3de244d830ad5c1feddc79b8432868"


class Lpips(nn.Module):
    """The distance, with random weights until `load_state_dict` or `load_lpips` fills them."""

    def __init__(self) -> None:
        super().__init__()
        self.features = _vgg16_features()
        self.heads = nn.ParameterList(
            nn.Parameter(torch.rand(1, channels[-1], 1, 1)) for channels in STAGES
        )
        self.requires_grad_(False)

    def forward(
        self, render: Float[Tensor, "B H W 3"], truth: Float[Tensor, "B H W 3"]
    ) -> Float[Tensor, " B"]:
        """Distance of each picture from its truth; sRGB in [0, 1], all pixels, differentiable."""
        distance = render.new_zeros(len(render))
        for a, b, head in zip(self._maps(render), self._maps(truth), self.heads, strict=True):
            distance = distance + ((a - b).square() * head).sum(1).mean((1, 2))
        return distance

    def _maps(self, images: Float[Tensor, "B H W 3"]) -> list[Tensor]:
        """Each stage's last rectified map, of unit length at every pixel."""
        shift, scale = images.new_tensor(SHIFT), images.new_tensor(SCALE)
        x = ((2 * images.clamp(0, 1) - 1 - shift) / scale).permute(0, 3, 1, 2)
        maps = []
        for layer in self.features:
            if isinstance(layer, nn.MaxPool2d):
                maps.append(x / (x.norm(dim=1, keepdim=True) + NORM_FLOOR))
            x = layer(x)
        return [*maps, x / (x.norm(dim=1, keepdim=True) + NORM_FLOOR)]


def lpips_vgg(
    render: Float[Tensor, "B H W 3"], truth: Float[Tensor, "B H W 3"]
) -> Float[Tensor, " B"]:
    """LPIPS with VGG16 over all pixels; 0 is equal, lower is better.

    sRGB in [0, 1], rescaled to [-1, 1] as the heads expect (`normalize=True` of the package; some
    avatar papers forget it). NaN, with the reason logged once, where no weights are configured or a
    side is under `SMALLEST_SIDE`.

    Raises:
        ConfigError: if configured files are missing or hold something else.
    """
    model = _configured(os.environ.get(WEIGHTS_VARIABLE), os.environ.get(HEADS_VARIABLE))
    if model is None or min(render.shape[1:3]) < SMALLEST_SIDE:
        return torch.full((len(render),), torch.nan, dtype=torch.float64)
    model = model.to(render.device)
    pairs = zip(render.float(), truth.float(), strict=True)
    # One picture at a time: VGG's first maps of a 512-pixel picture are 64 MB.
    return torch.cat([model(a[None], b[None]) for a, b in pairs]).double()


def configured_lpips() -> Lpips | None:
    """The distance with the weights that the environment names; None where it does not.

    Raises:
        ConfigError: if configured files are missing or hold something else.
    """
    weights, heads = os.environ.get(WEIGHTS_VARIABLE), os.environ.get(HEADS_VARIABLE)
    return _configured(weights, heads) if weights and heads else None


def load_lpips(weights: Path, heads: Path) -> Lpips:
    """Read torchvision's VGG16 and the published heads.

    Raises:
        ConfigError: naming the file, if it is missing or another than the published one.
    """
    model = Lpips()
    layers = {name: f"features.{name}" for name in model.features.state_dict()}
    names = [f"lin{index}.model.1.weight" for index in range(len(model.heads))]
    trunk = _read(weights, WEIGHTS_VARIABLE, WEIGHTS_SHA256)
    linear = _read(heads, HEADS_VARIABLE, HEADS_SHA256)
    model.features.load_state_dict({name: trunk[full] for name, full in layers.items()})
    for name, head in zip(names, model.heads, strict=True):
        head.copy_(linear[name].reshape(head.shape))
    return model


def _vgg16_features() -> nn.Sequential:
    layers: list[nn.Module] = []
    last = 3
    for stage in STAGES:
        if layers:
            layers.append(nn.MaxPool2d(2))
        for channels in stage:
            layers += [nn.Conv2d(last, channels, 3, padding=1), nn.ReLU()]
            last = channels
    return nn.Sequential(*layers)


def _read(path: Path, variable: str, sha256: str) -> dict[str, Tensor]:
    try:
        return load_pth(path, sha256)
    except ArtifactError as error:
        raise ConfigError(f"{variable}: {error}") from None


@cache
def _configured(weights: str | None, heads: str | None) -> Lpips | None:
    if not weights or not heads:
        logger.warning("lpips_vgg is not measured: set %s and %s", WEIGHTS_VARIABLE, HEADS_VARIABLE)
        return None
    return load_lpips(Path(weights), Path(heads))
