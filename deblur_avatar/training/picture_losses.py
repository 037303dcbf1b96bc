"""The losses of one picture in one pass over its pixels: `l1`, `structure` and `mask`.

A native kernel for float32 tensors, one for the CPU and one for a GPU. What the losses are is said
in `losses`, whose functions are its slow twins: in plain torch they and their gradients are some
forty walks over the picture.
"""

import ctypes
import math
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, Final

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from deblur_avatar.imaging import color
from deblur_avatar.rendering.native_build import (
    UNCONTRACTED,
    library_or_none,
    pointers,
)
from deblur_avatar.rendering.native_calls import cuda_library_or_none, launch, place_of
from deblur_avatar.run import kernel_threads
from deblur_avatar.training.losses import (
    STRUCTURE_SCALES,
    Comparison,
    coverage,
    photometric,
    structure,
)
from deblur_avatar.training.targets import Target

KERNEL: Final = Path(__file__).with_name("picture_losses.cpp")
CUDA_KERNEL: Final = Path(__file__).with_name("picture_losses.cu")

# What the kernel knows of the table of losses: regions and comparisons, in its order.
KNOWN: Final[tuple[tuple[str, Comparison], ...]] = (
    ("picture", photometric),
    ("box", structure),
    ("coverage", coverage),
)

SCRATCH: Final = 3  # pictures that the GPU's kernel works in

Weights = tuple[float, ...]  # of what it knows, in that order


def has_kernel(image: Float[Tensor, "H W 3"], alpha: Float[Tensor, "H W"]) -> bool:
    """Whether the kernel takes a render."""
    place = place_of(image, alpha)
    if place == "cuda":
        return _cuda_library() is not None
    return place == "cpu" and _library() is not None


def picture_losses(
    image: Float[Tensor, "H W 3"],
    alpha: Float[Tensor, "H W"],
    target: Target,
    averaging_space: str,
    weights: Mapping[Comparison, float],
) -> dict[Comparison, Float[Tensor, ""]]:
    """The losses of a render and its coverage that have weights, times these.

    Args:
        image: in the space in which light is averaged, not yet clamped.
        alpha: coverage.
        target: what they are compared with.
        averaging_space: the space in which light is averaged.
        weights: positive, of comparisons in `KNOWN`.
    """
    shares = tuple(weights.get(compare, 0.0) for _, compare in KNOWN)
    kernel = _PictureLossesOnGpu if place_of(image) == "cuda" else _PictureLosses
    found = kernel.apply(image, alpha, target, averaging_space == "linear", shares)
    pairs = zip(KNOWN, found, strict=True)
    return {compare: loss for (_, compare), loss in pairs if compare in weights}


class _PictureLosses(torch.autograd.Function):
    """Gradients come with the losses, for upstream gradients of 1, as those of a sum are."""

    @staticmethod
    def forward(
        ctx: Any, image: Tensor, alpha: Tensor, target: Target, linear: bool, weights: Weights
    ) -> tuple[Tensor, ...]:
        losses, *grads = _call(image, alpha, target, linear, weights)
        ctx.target, ctx.linear, ctx.weights = target, linear, weights
        ctx.save_for_backward(image, alpha, *grads)
        return losses.unbind()

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor | None, ...]:
        image, alpha, *grads = ctx.saved_tensors
        scales = [float(grad) for grad in upstream]
        weights = tuple(w * scale for w, scale in zip(ctx.weights, scales, strict=True))
        if weights != ctx.weights:
            grads = _call(image, alpha, ctx.target, ctx.linear, weights)[1:]
        return *grads, None, None, None


class _PictureLossesOnGpu(torch.autograd.Function):
    """Gradients of each loss come with it, since what is upstream is not waited for."""

    @staticmethod
    def forward(
        ctx: Any, image: Tensor, alpha: Tensor, target: Target, linear: bool, weights: Weights
    ) -> tuple[Tensor, ...]:
        values = image, alpha, target.image, target.matte
        inputs = [value.contiguous() for value in values]
        part = None if target.comparable is None else target.comparable.contiguous()
        sums = image.new_zeros(len(weights), dtype=torch.float64)
        scratch, losses = image.new_empty(SCRATCH, *image.shape), image.new_empty(len(weights))
        grads = image.new_empty(2, *image.shape), torch.empty_like(inputs[1])
        library = _cuda_library()
        assert library is not None
        sizes, shares = (
            (*alpha.shape, linear, *target.box),
            (ctypes.c_double * len(weights))(*weights),
        )
        launch(library, KERNEL.stem, sizes, shares, *inputs, part, sums, scratch, losses, *grads)
        ctx.save_for_backward(*grads)
        return losses.unbind()

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor | None, ...]:
        image_grads, alpha_grad = ctx.saved_tensors
        image_grad = (torch.stack(upstream[:2]) @ image_grads.flatten(1)).view(image_grads[0].shape)
        return image_grad, upstream[2] * alpha_grad, None, None, None


def _call(
    image: Tensor, alpha: Tensor, target: Target, linear: bool, weights: Weights
) -> tuple[Tensor, Tensor, Tensor]:
    """Losses, and the gradients of their sum with respect to image and alpha."""
    values = image, alpha, target.image, target.matte
    inputs = [value.contiguous() for value in values]
    part = None if target.comparable is None else target.comparable.contiguous()
    losses = image.new_empty(len(weights))
    grads = torch.empty_like(inputs[0]), torch.empty_like(inputs[1])
    library = _library()
    assert library is not None
    sizes = *alpha.shape, kernel_threads(), linear
    box, shares = (ctypes.c_int64 * 4)(*target.box), (ctypes.c_double * len(weights))(*weights)
    odd = library.picture_losses(*sizes, box, shares, *pointers(*inputs, part, losses, *grads))
    if odd:
        losses[:2] = math.nan
    return losses, *grads


@cache
def _library() -> ctypes.CDLL | None:
    library = library_or_none(KERNEL, "Losses are found", _defines(), UNCONTRACTED)
    if library is None:
        return None
    sizes = [*[ctypes.c_int64] * 2, *[ctypes.c_int] * 2]
    library.picture_losses.argtypes = [*sizes, *[ctypes.c_void_p] * 10]
    library.picture_losses.restype = ctypes.c_int
    return library


@cache
def _cuda_library() -> ctypes.CDLL | None:
    return cuda_library_or_none(CUDA_KERNEL, "Losses are found", _defines())


def _defines() -> list[str]:
    constants = {"STRUCTURE_SCALES": STRUCTURE_SCALES} | {
        name: getattr(color, name) for name in ("LINEAR_KNEE", "SLOPE", "OFFSET", "EXPONENT")
    }
    return [f"{name}={value}" for name, value in constants.items()]
