"""Clips to train a deblurring network on: blurred frames, and the sharp instants in their middle.

Dimensions. P persons, each in a motion of its own; F frames, L windows of sub-frames.
"""

from dataclasses import dataclass
from typing import ClassVar

from jaxtyping import UInt8
from torch import Tensor

from deblur_avatar.artifacts.averaging_space import check_averaging_space
from deblur_avatar.artifacts.storage import Artifact


@dataclass(frozen=True, kw_only=True)
class DeblurringClips(Artifact):
    """Synthetic persons, none of whom is in a scene, on black. Made by `deblurring_clips`.

    Blurred frames are those of `sharp`, seen through longer and longer exposures about the same
    instants. They may be noisy, as a sensor's; sharp ones are not.
    """

    schema: ClassVar[str] = "deblurring_clips/1"

    sharp: UInt8[Tensor, "P F H W 3"]  # sRGB
    sharp_mattes: UInt8[Tensor, "P F H W"]
    blurred: UInt8[Tensor, "P L F H W 3"]  # sRGB
    blurred_mattes: UInt8[Tensor, "P L F H W"]
    windows: tuple[int, ...]  # sub-frames
    averaging_spaces: tuple[str, ...]  # of each person's blur

    def validate(self) -> None:
        """Refuse clips whose windows or spaces are not said once each.

        Raises:
            ValueError: naming the field.
        """
        persons, windows = self.blurred.shape[:2]
        if len(self.windows) != windows:
            raise ValueError(f"windows: {len(self.windows)} numbers for {windows} windows")
        if len(self.averaging_spaces) != persons:
            raise ValueError(
                f"averaging_spaces: {len(self.averaging_spaces)} for {persons} persons"
            )
        for space in self.averaging_spaces:
            check_averaging_space(space)
