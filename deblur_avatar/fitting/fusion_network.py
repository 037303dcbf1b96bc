"""The paper's per-pixel choice between the sharp and the averaged render.

Conventions. The network's output M is the share of the averaged render: fused = (1 - M) sharp +
M averaged, both differentiable.
"""

from collections.abc import Sequence
from functools import lru_cache

import torch
from jaxtyping import Float
from torch import Tensor, nn

from deblur_avatar.avatar.networks import ConditionedMLP

FREQUENCIES = 4  # of the position code: sine and cosine of rows and of columns, 16 numbers


class FusionNetwork(nn.Module):
    """Predict M from the pose, the frame, the pixel's position and the sharp render around it.

    Source: Deblur-Avatar (arXiv 2501.13335) sec. III-D: 4 hidden layers of 64 over the pose code, a
    code for the frame, a position code and colour features of the sharp render. Sizes the paper
    does not give are those of its code (32 for the frame, 16 for the position, 32 for colour); one
    convolution stands in for the code's three.
    """

    def __init__(
        self, pose_code: int, frames: int, frame_codes: int, color_features: int,
        hidden: Sequence[int],
    ) -> None:  # fmt: skip
        super().__init__()
        self.sees_pose = pose_code > 0
        self.frame_codes = nn.Embedding(frames, frame_codes)
        self.look = nn.Conv2d(3, color_features, kernel_size=3, padding=1)
        self.network = ConditionedMLP(
            4 * FREQUENCIES + color_features, pose_code + frame_codes, hidden, 1
        )

    def forward(
        self, sharp: Float[Tensor, "H W 3"], pose_code: Float[Tensor, " E"] | None, frame: int,
        box: tuple[int, int, int, int],
    ) -> Float[Tensor, "H W 1"]:  # fmt: skip
        """M in (0, 1) inside a box (left, top, right, bottom); outside it both renders agree."""
        height, width = sharp.shape[:2]
        left, top, right, bottom = box
        seen = sharp[top:bottom, left:right]
        # The convolution as one product over all pixels: faster than as a convolution.
        patches = nn.functional.unfold(seen.permute(2, 0, 1)[None], kernel_size=3, padding=1)[0].T
        features = nn.functional.linear(patches, self.look.weight.flatten(1), self.look.bias)
        position = position_code(height, width, sharp)[top:bottom, left:right]
        features = features.reshape(*position.shape[:2], -1)
        condition = self.frame_codes.weight[frame]
        if pose_code is not None:
            condition = torch.cat([pose_code, condition])
        known = torch.cat([position, features], dim=2).flatten(0, 1)
        inside = self.network(known, condition).sigmoid()
        inside = inside.reshape(bottom - top, right - left)
        padding = (left, width - right, top, height - bottom)
        return nn.functional.pad(inside, padding)[..., None]


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
