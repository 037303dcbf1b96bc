"""What one training frame asks of an avatar."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.errors import ArtifactError

# Not a parameter: enough to see the person's edge from both sides at three scales.
BOX_MARGIN = 8  # pixels around the person in which structure is compared


@dataclass(frozen=True)
class Target:
    """One training frame: what was seen, where the person is in it, how far it is trusted."""

    image: Float[Tensor, "H W 3"]  # black where not comparable
    matte: Float[Tensor, "H W"]
    comparable: Float[Tensor, "H W"] | None  # 1 where colours mean something; None: everywhere
    box: tuple[int, int, int, int]
    weight: float  # in (0, 1], of what is compared with this frame

    def comparable_part(self, image: Float[Tensor, "H W C"]) -> Float[Tensor, "H W C"]:
        """A render, black where the frame's colours mean nothing."""
        return image if self.comparable is None else image * self.comparable[..., None]


def target_of(observations: Observations, index: int, device: torch.device) -> Target:
    """Bring one frame to the device.

    Raises:
        ArtifactError: if its mask is black.
    """
    image = observations.comparable_part(observations.frames[index].to(device).float() / 255, index)
    matte = observations.mattes[index].to(device).float() / 255
    rows, columns = torch.nonzero(matte > 0, as_tuple=True)
    if len(rows) == 0:
        raise ArtifactError(f"frame {index} has a black mask; its weight should be 0")
    height, width = matte.shape
    box = (
        max(int(columns.min()) - BOX_MARGIN, 0),
        max(int(rows.min()) - BOX_MARGIN, 0),
        min(int(columns.max()) + BOX_MARGIN + 1, width),
        min(int(rows.max()) + BOX_MARGIN + 1, height),
    )
    comparable = None
    if observations.comparable is not None:
        comparable = observations.comparable[index].to(device).float() / 255
    return Target(image, matte, comparable, box, float(observations.weights[index]))
