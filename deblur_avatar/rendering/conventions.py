"""Rasterization constants, on which all backends agree.

They are gsplat 1.5.3's, because its CUDA kernels have most of them compiled in.

A Gaussian of opacity `o`, with the mean `m` and the covariance `S` in the image, has at the pixel
centre `x` the opacity `alpha = min(MAX_ALPHA, o * exp(-0.5 * (x - m)^T S^-1 (x - m)))`. Pixel
centres lie at half-integers. Gaussians are composited front to back by the depth of their centres,
in the order of their numbers where depths are equal; `T`, the transmittance, is the product of
`1 - alpha` over what has been composited.
"""

from typing import Final

# Added to both variances of a projected Gaussian, px^2: the low-pass filter of the original
# 3D Gaussian splatting code, so that no Gaussian is thinner than a pixel.
EPS2D: Final = 0.3


def eps2d_of(binning: float) -> float:
    """Low-pass of a picture whose pixels are `binning` times as wide, in these wider pixels.

    An area average of a picture adds the variance of its box, less that of the pixel's own, to
    what the low-pass of the larger picture was.
    """
    return (EPS2D + (binning**2 - 1) / 12) / binning**2


# Gaussians whose centre is nearer than this are left out, metres (gsplat's default).
NEAR_PLANE: Final = 0.01

# The Jacobian of the projection is evaluated no farther outside the image than this fraction of its
# half width (or height): beyond, the linearisation would blow a Gaussian up over the whole image.
VIEW_MARGIN: Final = 0.3

# No Gaussian hides everything behind it; keeps 1 / (1 - alpha) finite.
MAX_ALPHA: Final = 0.999

# A fainter contribution cannot change an 8-bit pixel and is skipped.
MIN_ALPHA: Final = 1.0 / 255.0

# A pixel is finished when the next Gaussian would bring T to this or below; that one is left out.
MIN_TRANSMITTANCE: Final = 1e-4

# Red, green, blue and one more; depth comes on top.
MAX_CHANNELS: Final = 4
