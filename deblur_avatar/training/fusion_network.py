"""The paper's per-pixel choice between the sharp and the averaged render.

Conventions. The network's output M is the share of the averaged render: fused = (1 - M) sharp +
M averaged, both differentiable.
"""

from collections.abc import Sequence
from functools import lru_cache

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor, nn

from deblur_avatar.avatars.networks import ConditionedMLP
from deblur_avatar.avatars.params import Precision
from deblur_avatar.config.section import Count, Params, Positive

TOGETHER = 512  # rows of pixels are filled up to a multiple of it; changes no result
FREQUENCIES = (
    4  # the authors': of the position code: sine and cosine of rows and of columns, 16 numbers
)


class FusionNetworkParams(Params):
    """The paper's per-pixel blend of the sharp and the averaged render."""

    precision: Precision
    hidden: tuple[Count, ...]
    frame_codes: Count
    color_features: Count
    pose: bool  # whether it sees the pose's code (of avatars that have one)
    rate: Positive  # learning rate


class FusionNetwork(nn.Module):
    """Predict M from the pose, the frame, the pixel's position and the sharp render around it.

    Source: Deblur-Avatar (arXiv 2501.13335) sec. III-D: 4 hidden layers of 64 over the pose code, a
    code for the frame, a position code and colour features of the sharp render. Sizes the paper
    does not give are those of its code (32 for the frame, 16 for the position, 32 for colour); one
    convolution stands in for the code's three.
    """

    def __init__(
        self, pose_code: int, frames: int, frame_codes: int, color_features: int,
        hidden: Sequence[int], precision: Precision,
    ) -> None:  # fmt: skip
        super().__init__()
        self.sees_pose = pose_code > 0
        self.frame_codes = nn.Embedding(frames, frame_codes)
        self.look = nn.Conv2d(3, color_features, kernel_size=3, padding=1)
        self.network = ConditionedMLP(
            4 * FREQUENCIES + color_features, pose_code + frame_codes, hidden, 1, precision
        )

    def forward(
        self, sharp: Float[Tensor, "H W 3"], covered: Bool[Tensor, "H W"],
        pose_code: Float[Tensor, " E"] | None, frame: int,
    ) -> Float[Tensor, "H W 1"]:  # fmt: skip
        """M in (0, 1) where either render shows anything; elsewhere it decides nothing and is 0.

        Args:
            sharp: the render that the network looks at.
            covered: pixels that a Gaussian reaches in one of both renders. The others, three
                quarters of a person's box, are background in both, whatever M.
            pose_code: of the frame's centre, if the network sees the pose.
            frame: training position.
        """
        height, width = covered.shape
        asked = covered.flatten().nonzero()[:, 0]
        share = sharp.new_zeros(height * width)
        if len(asked):
            # Filled up with pixel 0, whose answers are dropped: a product is prepared anew for
            # each number of rows it meets.
            pixels = nn.functional.pad(asked, (0, -len(asked) % TOGETHER))
            colors = _around(sharp, pixels)
            features = nn.functional.linear(colors, self.look.weight.flatten(1), self.look.bias)
            position = position_code(height, width, sharp).flatten(0, 1)[pixels]
            condition = self.frame_codes.weight[frame]
            if pose_code is not None:
                condition = torch.cat([pose_code, condition])
            known = torch.cat([position, features], dim=1)
            answers = self.network(known, condition)[: len(asked), 0].sigmoid()
            share = share.scatter(0, asked, answers)
        return share.reshape(height, width, 1)


def _around(picture: Float[Tensor, "H W 3"], pixels: Int64[Tensor, " P"]) -> Float[Tensor, "P 27"]:
    """Each pixel's neighbourhood of 3 x 3, black beyond the edge, as a convolution sees it."""
    width = picture.shape[1]
    planes = nn.functional.pad(picture.permute(2, 0, 1), (1, 1, 1, 1)).flatten(1)
    corners = pixels + pixels.div(width, rounding_mode="floor") * 2
    steps = torch.arange(3, device=pixels.device)
    offsets = ((width + 2) * steps[:, None] + steps).reshape(-1, 1)
    places = (corners + offsets).flatten()
    return planes.gather(1, places.expand(3, -1)).reshape(27, -1).T


def position_code(height: int, width: int, like: Tensor) -> Float[Tensor, "H W 16"]:
    """Sines and cosines of each pixel's row and column, scaled to one turn.

    Source: the 2-D sinusoidal code of the authors' fusion network (after BAGS).
    """
    return _position_code(height, width, like.dtype, like.device)


@lru_cache(maxsize=4)
def _position_code(height: int, width: int, dtype: torch.dtype, device: torch.device) -> Tensor:
    rates = 10000 ** (-torch.arange(FREQUENCIES, dtype=dtype) / FREQUENCIES)
    rows = torch.arange(height, dtype=dtype)[:, None] * (2 * torch.pi / height) * rates
    columns = torch.arange(width, dtype=dtype)[:, None] * (2 * torch.pi / width) * rates
    row_code = torch.cat([rows.sin(), rows.cos()], 1)[:, None].expand(-1, width, -1)
    column_code = torch.cat([columns.sin(), columns.cos()], 1)[None].expand(height, -1, -1)
    return torch.cat([row_code, column_code], dim=-1).to(device)
