"""How much brighter each frame is than the clip, where exposure or light does not hold still.

Conventions. Gains multiply a picture in the space in which its light is averaged, where a change of
light is nearly one factor in sRGB values too (a power of it). Logarithms of gains have the mean
zero over the frames that were looked at: an avatar is as bright as the clip is on average. Nothing
of them is left in it.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.imaging.exposure import decode
from deblur_avatar.training.targets import Target

# Not parameters: a gain settles in five steps, and no camera drifts by more.
BLEND = 0.5  # of what a visit finds with what was known
MAX_VALUE = 1.4  # of a gain's logarithm: two stops


class ExposureGains:
    """One gain a frame: by how much the frame is brighter than its render, where the person is.

    The first comparison finds how the avatar's colours begin, not the light, and is only counted.
    """

    def __init__(self, frames: int, averaging_space: str, device: torch.device) -> None:
        self._averaging_space = averaging_space
        self._log_gains = torch.zeros(frames, device=device)
        self._count = torch.zeros(frames, dtype=torch.long, device=device)

    def of(self, frame: int) -> Float[Tensor, ""]:
        """What a render is multiplied by before it is compared with a frame."""
        known = self._count > 1
        if not bool(known[frame]):
            return torch.ones_like(self._log_gains[0])
        return (self._log_gains[frame] - self._log_gains[known].mean()).exp()

    def observe(self, frame: int, render: Float[Tensor, "H W 3"], target: Target) -> None:
        """Compare a frame with its render over the background, which has no gain yet."""
        seen = decode(target.image, self._averaging_space)
        inside = target.comparable_part(target.matte[..., None])
        ratio = (seen * inside).sum() / (render.detach() * inside).sum().clamp(min=1e-6)
        found = ratio.clamp(min=1e-6).log().clamp(-MAX_VALUE, MAX_VALUE)
        count = int(self._count[frame])
        blend = BLEND if count > 1 else 1.0
        self._log_gains[frame] = torch.lerp(self._log_gains[frame], found, blend)
        self._count[frame] += 1

    def state(self) -> dict[str, Tensor]:
        """What a later stage goes on from."""
        return {"found": self._log_gains, "visits": self._count}

    def restore(self, state: dict[str, Tensor]) -> None:
        """Take over what `state` gave."""
        self._log_gains.copy_(state["found"])
        self._count.copy_(state["visits"])
