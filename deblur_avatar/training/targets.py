"""What one training frame asks of an avatar, at the size that fitting is at.

Where the background is known it stays in the frame, and renders are put in front of it. A smaller
frame is the area average of the full one, in the space in which light is averaged.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.avatars.render import light_behind
from deblur_avatar.errors import ArtifactError
from deblur_avatar.geometry.cameras import Camera
from deblur_avatar.imaging.exposure import AveragingSpace, decode, encode, over

# Not a parameter: enough to see the person's edge from both sides at three scales.
BOX_MARGIN = 8  # pixels around the person in which structure is compared
# Of all frames in full, converted; not parameters: they change no result.
FLOATS_A_PIXEL = 8  # image, matte, comparable, background
KEPT_ON_A_GPU = 2**29  # floats: 2 GiB, 268 frames of 500 pixels a side


@dataclass(frozen=True)
class Target:
    """One training frame: what was seen, where the person is in it, how far it is trusted."""

    image: Float[Tensor, "H W 3"]  # black where not comparable
    matte: Float[Tensor, "H W"]
    comparable: Float[Tensor, "H W"] | None  # 1 where colours mean something; None: everywhere
    box: tuple[int, int, int, int]
    weight: float  # in (0, 1], of what is compared with this frame
    background: Float[Tensor, "H W 3"] | None = None  # light behind, as averaged; None: black

    def behind(
        self, image: Float[Tensor, "H W 3"], alpha: Float[Tensor, "H W"]
    ) -> Float[Tensor, "H W 3"]:
        """A render's light, and that of the background which its coverage lets through."""
        return image if self.background is None else over(image, alpha, self.background)

    def comparable_part(self, image: Float[Tensor, "H W C"]) -> Float[Tensor, "H W C"]:
        """A render, black where the frame's colours mean nothing."""
        return image if self.comparable is None else image * self.comparable[..., None]


def training_frames(observations: Observations) -> list[int]:
    """Positions of the training frames that show a person.

    Raises:
        ArtifactError: if there is none, or the mask of one is black.
    """
    frames = observations.shown
    if not frames:
        raise ArtifactError("no training frame shows a person; check masks and weights")
    for index in frames:
        if not bool(observations.mattes[index].any()):
            number = observations.frame_indices[index]
            raise ArtifactError(f"frame {number} has a black mask; its weight should be 0")
    return frames


class Targets:
    """The frames at one size, each with what is behind the person.

    Smaller ones are kept, and on a GPU full ones, too, where there are not too many: there
    converting one takes as long as comparing it.
    """

    def __init__(self, observations: Observations, share: float, device: torch.device) -> None:
        self._observations, self._share, self._device = observations, share, device
        floats = FLOATS_A_PIXEL * observations.mattes.numel()
        self._keeps = share != 1 or (device.type != "cpu" and floats <= KEPT_ON_A_GPU)
        self._kept: dict[int, Target] = {}
        self._still: Tensor | None = None  # light of the one background
        height, width = observations.frames.shape[1:3]
        camera = replace(observations.camera.to(device), width=width, height=height)
        self.camera = camera if share == 1 else camera.binned(share)

    def __getitem__(self, index: int) -> Target:
        """One frame."""
        if not self._keeps:
            return self._converted(index)
        if index not in self._kept:
            self._kept[index] = self._converted(index)
        return self._kept[index]

    def _converted(self, index: int) -> Target:
        target = target_of(self._observations, index, self._device)
        if self._share != 1:
            target = _smaller(target, self.camera, self._observations.averaging_space)
        return replace(target, background=self._background(index))

    def _background(self, index: int) -> Float[Tensor, "H W 3"] | None:
        """Light behind the person; that of a still camera is converted once."""
        if self._still is not None:
            return self._still
        light = light_behind(self._observations, index, self._device)
        if light is None:
            return None
        if self._share != 1:
            light = _averaged(light, self.camera)
        held = self._observations.backgrounds
        if held is not None and len(held) == 1:
            self._still = light
        return light


def target_of(observations: Observations, index: int, device: torch.device) -> Target:
    """Bring one frame, whose mask shows a person, to the device; without its background."""
    image = observations.comparable_part(observations.frames[index].to(device).float() / 255, index)
    matte = observations.mattes[index].to(device).float() / 255
    comparable = None
    if observations.comparable is not None:
        comparable = observations.comparable[index].to(device).float() / 255
    weight = float(observations.weights[index])
    return Target(image, matte, comparable, _box(observations.mattes[index]), weight)


def _box(matte: Float[Tensor, "H W"] | UInt8[Tensor, "H W"]) -> tuple[int, int, int, int]:
    """Where the person is, with a margin."""
    height, width = matte.shape
    columns, rows = (torch.nonzero(matte.amax(axis)).flatten() for axis in (0, 1))
    return (
        max(int(columns.min()) - BOX_MARGIN, 0),
        max(int(rows.min()) - BOX_MARGIN, 0),
        min(int(columns.max()) + BOX_MARGIN + 1, width),
        min(int(rows.max()) + BOX_MARGIN + 1, height),
    )


def _smaller(target: Target, camera: Camera, averaging_space: AveragingSpace | str) -> Target:
    """The same frame as a binned camera sees it."""
    light = _averaged(decode(target.image, averaging_space), camera)
    image = encode(light, averaging_space)
    matte, comparable = _averaged(target.matte, camera), target.comparable
    if comparable is not None:
        # Only where all that a pixel averages means something.
        comparable = (_averaged(comparable, camera) > 1 - 1e-6).to(matte)
        image = image * comparable[..., None]
    return Target(image, matte, comparable, _box(matte), target.weight)


def _averaged(values: Float[Tensor, "H W *C"], camera: Camera) -> Float[Tensor, "h w *C"]:
    """Area averages over the pixels of a binned camera."""
    size = camera.height, camera.width
    planes = values.reshape(*values.shape[:2], -1).permute(2, 0, 1)
    small = torch.nn.functional.adaptive_avg_pool2d(planes[None], size)[0].permute(1, 2, 0)
    return small.reshape(*size, *values.shape[2:]).contiguous()
