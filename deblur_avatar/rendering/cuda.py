"""GPU rasterizer, by way of gsplat: the one module that knows it.

gsplat 1.5.3 has the leading batch dimension that one call for B poses needs. Its conventions are
those of `conventions.py`; the differences met here are of form. It composites colours over black,
so that the background is added behind; and where `radii` is 0 its other numbers are uninitialised
memory.

Its gradients of the camera mix the poses of a batch (each warp adds up by camera alone), which is
one reason why no backend offers them.
"""

import math
import weakref
from types import ModuleType
from typing import Final

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.errors import ConfigError
from deblur_avatar.rendering.conventions import NEAR_PLANE
from deblur_avatar.rendering.covariances import upper_triangles
from deblur_avatar.rendering.inputs import refuse_not_finite
from deblur_avatar.rendering.result import Rasterization, ScreenStatistics

TILE: Final = 16  # pixels: gsplat's own, for which its kernels are made


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
    background: Float[Tensor, " C"] | None,
    average: bool,
    depth: bool,
    eps2d: float,
) -> Rasterization:
    """Rasterize with gsplat; see the package for the arguments.

    Raises:
        ValueError: the tensors are not float32 on a GPU, or a value is NaN or infinite.
        ConfigError: gsplat is not installed, or its kernels cannot be compiled.
    """
    _check_place(means)
    refuse_not_finite(
        means=means, covars=covars, opacities=opacities, colors=colors, background=background
    )
    B, N, C = len(means), means.shape[1], colors.shape[1]
    if covars.shape[-1] == 3:
        covars = upper_triangles(0.5 * (covars + covars.mT))  # the gradient becomes symmetric
    pictures, alpha, means2d, radii = _drawn(
        means, covars.expand(B, N, 6), opacities, colors, viewmat, K, width, height, depth, eps2d
    )
    if average:
        pictures, alpha = pictures.mean(0, keepdim=True), alpha.mean(0, keepdim=True)
    image = pictures[..., :C]
    if background is not None:
        image = image + (1 - alpha)[..., None] * background
    return Rasterization(
        image=image,
        alpha=alpha,
        depth=pictures[..., C] if depth else None,
        radii=radii,
        screen=_watch(means2d, radii),
    )


def _drawn(
    means: Float[Tensor, "B N 3"],
    covars: Float[Tensor, "B N 6"],
    opacities: Float[Tensor, " N"],
    colors: Float[Tensor, "N C"],
    viewmat: Float[Tensor, "4 4"],
    K: Float[Tensor, "3 3"],
    width: int,
    height: int,
    depth: bool,
    eps2d: float,
) -> tuple[Tensor, Float[Tensor, "B H W"], Float[Tensor, "B 1 N 2"], Tensor]:
    """Pictures, over black and with depth as their last channel; coverage, centres and radii.

    By the steps of gsplat's `rasterization`, which itself takes whole covariance matrices apart by
    an index whose gradient is sorted.
    """
    gsplat, B, N = _gsplat(), len(means), means.shape[1]
    radii, means2d, depths, conics, _ = gsplat.fully_fused_projection(
        means, covars, None, None, viewmat.expand(B, 1, 4, 4), K.expand(B, 1, 3, 3), width, height,
        eps2d=eps2d, near_plane=NEAR_PLANE,
        opacities=opacities.expand(B, N),  # for tighter bounds
    )  # fmt: skip
    shown = colors.expand(B, 1, N, colors.shape[1])
    if depth:
        shown = torch.cat([shown, depths[..., None]], dim=-1)
    tiles = [math.ceil(side / TILE) for side in (width, height)]
    _, isect_ids, flatten_ids = gsplat.isect_tiles(means2d, radii, depths, TILE, *tiles)
    offsets = gsplat.isect_offset_encode(isect_ids, B, *tiles).view(B, 1, *reversed(tiles))
    pictures, alpha = gsplat.rasterize_to_pixels(
        means2d, conics, shown, opacities.expand(B, 1, N), width, height, TILE, offsets,
        flatten_ids, absgrad=True,
    )  # fmt: skip
    return pictures[:, 0], alpha[:, 0, ..., 0], means2d, radii[:, 0].amax(-1)


def _check_place(means: Tensor) -> None:
    if means.dtype != torch.float32 or means.device.type != "cuda":
        raise ValueError(
            f"the cuda backend computes in float32 on a GPU, got {means.dtype} on {means.device};"
            " backend='reference' takes any"
        )


class _Watched(ScreenStatistics):
    """Screen statistics that keep the projected centres, on which gsplat leaves their own."""

    def __init__(self, means2d: Float[Tensor, "B 1 N 2"]) -> None:
        super().__init__()
        self.means2d = means2d


def _watch(means2d: Float[Tensor, "B 1 N 2"], radii: Tensor) -> ScreenStatistics:
    """Fill screen statistics when the gradient of the projected centres arrives."""
    screen = _Watched(means2d)
    if means2d.requires_grad:
        seen = (radii > 0)[..., None]
        # Weakly: the graph keeps its hooks and the centres their graph, so that a hook that keeps
        # the centres is never freed, nor all that they hold: 13 MB a step of 80,000 Gaussians.
        asked = weakref.ref(screen)

        def add(grad: Tensor) -> None:
            asking = asked()
            if asking is None:
                return
            # gsplat's backward leaves the absolute gradient on the tensor itself.
            absgrad = asking.means2d.absgrad[:, 0]  # type: ignore[attr-defined]
            asking.add(torch.where(seen, grad[:, 0], 0), torch.where(seen, absgrad, 0))

        means2d.register_hook(add)
    return screen


def _gsplat() -> ModuleType:
    try:
        import gsplat
        from gsplat.cuda._backend import _C
    except ImportError as error:
        raise ConfigError(
            "tensors on a GPU are rasterized by gsplat: pip install 'deblur-avatar[cuda]', or set"
            " DEBLUR_AVATAR_DEVICE=cpu"
        ) from error
    except (OSError, RuntimeError) as error:  # of the compiler that it calls
        raise ConfigError(
            f"gsplat cannot compile its kernels: {error!s:.300}; mend that, or set"
            " DEBLUR_AVATAR_DEVICE=cpu"
        ) from error
    if _C is None:
        raise ConfigError(
            "gsplat compiles its kernels with nvcc, which it did not find: install CUDA's compiler"
            " and set CUDA_HOME, or set DEBLUR_AVATAR_DEVICE=cpu"
        )
    return gsplat
