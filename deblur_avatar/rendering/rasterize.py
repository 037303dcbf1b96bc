"""Rasterization of Gaussians: one call, three backends, the same result.

- `reference`: plain torch, any device, float32 or float64; slow, the definition of the others.
- `cpu`: a native kernel, compiled on first use, float32; the default for tensors on the CPU.
- `cuda`: gsplat, float32; the default for tensors on a GPU.

Cameras follow OpenCV: +X right, +Y down, +Z forward. The numbers that define a picture (low-pass,
near plane, opacity limits) are in `conventions.py`, shared by all three.
"""

import os
import warnings
from collections.abc import Callable
from functools import cache
from typing import Final

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.rendering import cpu, reference
from deblur_avatar.rendering.conventions import EPS2D
from deblur_avatar.rendering.covariances import covariances
from deblur_avatar.rendering.inputs import check_camera, check_inputs
from deblur_avatar.rendering.native_build import BuildError
from deblur_avatar.rendering.result import Rasterization, ScreenStatistics

__all__ = ["BACKENDS", "Rasterization", "ScreenStatistics", "covariances", "rasterize"]

BACKENDS: Final = ("reference", "cpu", "cuda")

# Names the backend for a whole process, where no argument does.
BACKEND_VARIABLE: Final = "DEBLUR_AVATAR_RASTERIZER"


def rasterize(
    means: Float[Tensor, "B N 3"],
    covars: Float[Tensor, "*rest N 3 3"] | Float[Tensor, "*rest N 6"],
    opacities: Float[Tensor, " N"],
    colors: Float[Tensor, "N C"],
    viewmat: Float[Tensor, "4 4"],
    K: Float[Tensor, "3 3"],
    width: int,
    height: int,
    *,
    background: Float[Tensor, " C"] | None = None,
    average: bool = False,
    depth: bool = False,
    eps2d: float = EPS2D,
    backend: str | None = None,
) -> Rasterization:
    """Rasterize B poses of one set of Gaussians as one camera sees them.

    Differentiable in means, covars, opacities, colors and background. The camera is not: move the
    Gaussians instead.

    Args:
        means: posed centres in world space, metres.
        covars: posed covariances, square metres, symmetric and positive semi-definite; [B, N, ...],
            or [N, ...] where all poses share them. The six numbers are the upper triangle xx, xy,
            xz, yy, yz, zz; they are the faster form. The gradient has the form of the argument: a
            whole matrix gets a symmetric one.
        opacities: peak opacities in [0, 1].
        colors: any 1 to 4 channels, in the space in which light is to be averaged.
        viewmat: world to camera, rigid, OpenCV axes, metres.
        K: pinhole without skew, pixels.
        width: of the image, pixels.
        height: of the image, pixels.
        background: what is seen where nothing covers; black if None.
        average: return the mean of the B pictures instead; the fast backends never hold all B.
        depth: also accumulate depth.
        eps2d: low-pass, added to both variances of a projected Gaussian, px^2 (`eps2d_of`).
        backend: one of BACKENDS. If None, the environment variable DEBLUR_AVATAR_RASTERIZER
            decides, then the device and dtype of the tensors.

    Raises:
        ValueError: shapes, dtypes or devices do not fit, a value is NaN or infinite, the camera is
            not a pinhole or asks for a gradient, or the backend is unknown.
    """
    check_inputs(means, covars, opacities, colors, viewmat, K, width, height, background)
    check_camera(viewmat, K)
    return _backend(backend, means)(
        means,
        covars,
        opacities,
        colors,
        viewmat,
        K,
        width,
        height,
        background=background,
        average=average,
        depth=depth,
        eps2d=eps2d,
    )


def _backend(name: str | None, means: Tensor) -> Callable[..., Rasterization]:
    """Find the backend: argument, then environment, then where and what the tensors are."""
    source, chosen = "backend", name
    if chosen is None:
        source, chosen = BACKEND_VARIABLE, os.environ.get(BACKEND_VARIABLE) or None
    if chosen is not None:
        if chosen not in BACKENDS:
            raise ValueError(f"{source} must be one of {', '.join(BACKENDS)}, got {chosen!r}")
    elif means.dtype == torch.float32 and means.device.type in ("cpu", "cuda"):
        chosen = means.device.type
    else:
        chosen = "reference"
    if chosen == "cuda":
        from deblur_avatar.rendering import cuda

        return cuda.rasterize
    return cpu.rasterize if chosen == "cpu" and _compiles() else reference.rasterize


@cache
def _compiles() -> bool:
    """Try to build the native kernel; where that fails say so, once."""
    try:
        cpu.kernel()
    except BuildError as error:
        warnings.warn(
            "the cpu rasterizer cannot be compiled, so the reference takes over, some fifty times"
            f" slower: {error}",
            stacklevel=4,
        )
        return False
    return True
