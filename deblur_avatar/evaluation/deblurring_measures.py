"""Measures of deblurring in the picture: frames and mattes against the sharp ones."""

from jaxtyping import Float
from torch import Tensor

from deblur_avatar.imaging import metrics
from deblur_avatar.imaging.deblurring.deblurrer import Pictures, values_of


def deblurring_measures(
    made: Pictures, given: Pictures, sharp: Pictures
) -> dict[str, Float[Tensor, " F"]]:
    """PSNR of each frame, dB: of its colours, of those of the person alone, and of its matte.

    Args:
        made: what a deblurrer made, or what it was given.
        given: the blurred pictures; the person's pixels are those that these or the sharp ones
            show any of.
        sharp: the truth.
    """
    pictures, wanted = values_of(made.frames), values_of(sharp.frames)
    layers = [values_of(one.mattes)[..., None].expand(*one.frames.shape) for one in (made, sharp)]
    person = (sharp.mattes > 0) | (given.mattes > 0)
    return {
        "psnr": metrics.psnr(pictures, wanted),
        "psnr_person": metrics.psnr(pictures, wanted, person),
        "psnr_matte": metrics.psnr(layers[0], layers[1]),
    }
