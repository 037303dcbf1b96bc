"""Neighbours keep their distances when the body moves: a term of the objective for means or shapes.

Conventions. A *spacing* is the distance of a Gaussian's values from a neighbour's. A pose in which
two are the same gets no gradient from them; where both spacings are equal, neither does.

Float32 tensors on the CPU go through a native kernel, which finds the gradients along with the
term: in plain torch this is many short calls over strided lists.
"""

import ctypes
import math
from functools import cache
from pathlib import Path
from typing import Any, Final

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from deblur_avatar.avatars.native_terms import NativeTerm
from deblur_avatar.rendering.native_build import (
    library_or_none,
    pointers,
)

KERNEL: Final = Path(__file__).with_name("isometry.cpp")

# What the kernel says is wrong.
_NOT_FINITE, _NO_SUCH_NEIGHBOUR = 1, 2


def isometry(
    canonical: Float[Tensor, "N D"],
    posed: Float[Tensor, "N D"],
    neighbours: Int64[Tensor, "N K"],
) -> Float[Tensor, ""]:
    """Mean absolute difference of canonical and posed spacings; not finite if one of them is not.

    Of means it is in metres: 3DGS-Avatar, L_isopos, after Prokudin et al., "as isometric as
    possible". Of the upper triangles of covariances it is in square metres: L_isocov. Like there,
    off-diagonal entries count once, so that one is not quite invariant under rotation.

    Raises:
        ValueError: the sizes do not fit.
        IndexError: there is no such neighbour.
    """
    if canonical.shape != posed.shape or len(neighbours) != len(canonical):
        raise ValueError(
            "canonical and posed values must be [N, D] and neighbours [N, K], got "
            f"{[*canonical.shape]}, {[*posed.shape]} and {[*neighbours.shape]}"
        )
    native = all(v.device.type == "cpu" and v.dtype == torch.float32 for v in (canonical, posed))
    whole = neighbours.device.type == "cpu" and neighbours.dtype == torch.int64
    if native and whole and _library() is not None:
        return _Isometry.apply(canonical, posed, neighbours)
    return isometry_reference(canonical, posed, neighbours)


def isometry_reference(
    canonical: Float[Tensor, "N D"],
    posed: Float[Tensor, "N D"],
    neighbours: Int64[Tensor, "N K"],
) -> Float[Tensor, ""]:
    """The same in plain torch, on any device and in any precision: the kernel's slow twin."""
    apart = (_spacings(canonical, neighbours) - _spacings(posed, neighbours)).abs()
    return apart.sum() / max(1, apart.numel())


def _spacings(
    values: Float[Tensor, "N D"], neighbours: Int64[Tensor, "N K"]
) -> Float[Tensor, "N K"]:
    # Not `norm`: two Gaussians in one place are the case where its gradient is not a number.
    squared = (values[neighbours] - values[:, None]).square().sum(-1)
    return squared.clamp(min=torch.finfo(values.dtype).tiny).sqrt()


class _Isometry(NativeTerm):
    @staticmethod
    def forward(ctx: Any, canonical: Tensor, posed: Tensor, neighbours: Tensor) -> Tensor:
        inputs = [value.contiguous() for value in (canonical, posed, neighbours)]
        grads = [
            torch.zeros_like(value) if wanted else None
            for value, wanted in zip(inputs[:2], ctx.needs_input_grad[:2], strict=True)
        ]
        loss = canonical.new_empty(())
        library = _library()
        assert library is not None
        sizes = *canonical.shape, neighbours.shape[1]
        problem = library.isometry(*sizes, *pointers(*inputs, loss, *grads))
        if problem == _NO_SUCH_NEIGHBOUR:
            raise IndexError(f"neighbours must be indices of {len(canonical)} Gaussians")
        if problem == _NOT_FINITE:
            loss.fill_(math.nan)
        ctx.save_for_backward(*grads)
        return loss


@cache
def _library() -> ctypes.CDLL | None:
    library = library_or_none(KERNEL, "Isometry is found")
    if library is None:
        return None
    library.isometry.argtypes = [*[ctypes.c_int64] * 3, *[ctypes.c_void_p] * 6]
    library.isometry.restype = ctypes.c_int
    return library
