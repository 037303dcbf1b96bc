"""What colour each Gaussian has, seen from where the camera stands.

Conventions. Colours are in [0, 1] in the avatar's `averaging_space`; directions are unit vectors
from the camera, turned back into canonical space.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from deblur_avatar.avatars.networks import ConditionedMLP, spherical_harmonics
from deblur_avatar.avatars.params import Precision
from deblur_avatar.geometry.rotations import axis_angle_to_matrix

HARMONICS = 15  # of degrees 1 to 3: what `spherical_harmonics` returns
MAX_VIEW_NOISE = 90.0  # degrees; 3DGS-Avatar's clamp, the width is a parameter


class ColorNetwork(nn.Module):
    """Colour from a Gaussian's features, the deformation's code, the frame and the view direction.

    Source: 3DGS-Avatar, Qian et al., CVPR 2024, sec. 3.4: directions are canonicalised by the
    transpose of each point's skinning rotation, and turned by a random rotation in training.
    """

    def __init__(
        self, features: int, deformation: int, latent: int, frames: int, hidden: Sequence[int],
        precision: Precision,
    ) -> None:  # fmt: skip
        super().__init__()
        self.latents = nn.Embedding(frames, latent)
        inputs = features + HARMONICS + deformation
        self.network = ConditionedMLP(inputs, latent, hidden, 3, precision)

    def forward(
        self,
        features: Float[Tensor, "N D"],
        directions: Float[Tensor, "N 3"],
        deformation: Float[Tensor, "N Z"],
        frame: int,
    ) -> Float[Tensor, "N 3"]:
        """Colours in (0, 1). Frames after the clip's last borrow its latent code."""
        latent = self.latents.weight[min(frame, self.latents.num_embeddings - 1)]
        inputs = torch.cat([features, spherical_harmonics(directions), deformation], dim=1)
        return self.network(inputs, latent).sigmoid()

    def fill_untrained_latents(self, trained: Sequence[int]) -> None:
        """Give each frame that was never trained the latent code of the nearest one that was.

        Source: 3DGS-Avatar draws all unknown frames with the last training frame's code.
        """
        codes = self.latents.weight
        known = torch.tensor(sorted(trained), device=codes.device)
        apart = torch.arange(len(codes), device=codes.device)[:, None] - known
        with torch.no_grad():
            codes.copy_(codes[known[apart.abs().argmin(1)]])


def random_view_rotation(
    degrees: float, generator: torch.Generator, like: Tensor
) -> Float[Tensor, "3 3"]:
    """A rotation that keeps the colour network from tying colours to the one training camera.

    Source: 3DGS-Avatar: angles about x and z are normal, clamped to +-90 degrees, about y uniform.
    """
    draw = torch.randn(3, generator=generator, dtype=like.dtype).to(like)
    turn = torch.rand(1, generator=generator, dtype=like.dtype).to(like)
    angles = torch.deg2rad((draw * degrees).clamp(-MAX_VIEW_NOISE, MAX_VIEW_NOISE))
    about_y = torch.deg2rad(turn * degrees)
    still = like.new_zeros(1)
    axes = torch.stack(
        [
            torch.cat([angles[:1], still, still]),
            torch.cat([still, about_y, still]),
            torch.cat([still, still, angles[2:]]),
        ]
    )
    x, y, z = axis_angle_to_matrix(axes)
    return x @ y @ z
