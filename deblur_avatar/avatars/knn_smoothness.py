"""k-nearest-neighbour smoothness: a term of the objective that Gaussians take after neighbours.

Float32 tensors go through a native kernel, one for the CPU and one for a GPU, which finds the
gradient along with the term: in plain torch this is many short calls over gathered rows.
"""

import ctypes
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
from deblur_avatar.rendering.native_calls import cuda_library_or_none, launch, place_of
from deblur_avatar.run import kernel_threads

KERNEL: Final = Path(__file__).with_name("knn_smoothness.cpp")
CUDA_KERNEL: Final = Path(__file__).with_name("knn_smoothness.cu")

_NO_SUCH_NEIGHBOUR = 1  # what the kernel says is wrong


def knn_smoothness(
    values: Float[Tensor, "N D"], neighbours: Int64[Tensor, "N K"]
) -> Float[Tensor, ""]:
    """Mean absolute difference between a Gaussian's values and its neighbours'; 0 without any.

    Where the camera sees a Gaussian the picture outweighs this; where it does not, values become
    those of the nearest that it does see. Absolute, so that an edge costs no more than a slope.

    Raises:
        ValueError: the sizes do not fit.
        IndexError: there is no such neighbour; the twin, in torch's words, raises RuntimeError, and
            on a GPU, which is not waited for, the loss is not a number.
    """
    if len(neighbours) != len(values):
        raise ValueError(
            "values must be [N, D] and neighbours [N, K], got "
            f"{[*values.shape]} and {[*neighbours.shape]}"
        )
    whole = neighbours.device == values.device and neighbours.dtype == torch.int64
    place = place_of(values) if whole else None
    if place == "cpu" and _library() is not None:
        return _Smoothness.apply(values, neighbours)
    if place == "cuda" and _cuda_library() is not None:
        return _SmoothnessOnGpu.apply(values, neighbours)
    return knn_smoothness_reference(values, neighbours)


def knn_smoothness_reference(
    values: Float[Tensor, "N D"], neighbours: Int64[Tensor, "N K"]
) -> Float[Tensor, ""]:
    """The same in plain torch, on any device and in any precision: the kernel's slow twin."""
    # [D, K, N]: rows without strides, five times as fast as [N, K, D].
    rows, near = values.T.contiguous(), neighbours.T.contiguous()
    apart = rows.index_select(1, near.flatten()).unflatten(1, near.shape) - rows[:, None]
    return apart.abs().sum() / max(1, apart.numel())


class _Smoothness(NativeTerm):
    @staticmethod
    def forward(ctx: Any, values: Tensor, neighbours: Tensor) -> Tensor:
        inputs = values.contiguous(), neighbours.contiguous()
        grad = torch.empty_like(inputs[0]) if ctx.needs_input_grad[0] else None
        loss = values.new_empty(())
        library = _library()
        assert library is not None
        sizes = *values.shape, neighbours.shape[1], kernel_threads()
        problem = library.knn_smoothness(*sizes, *pointers(*inputs, loss, grad))
        if problem == _NO_SUCH_NEIGHBOUR:
            raise IndexError(f"neighbours must be indices of {len(values)} Gaussians")
        ctx.save_for_backward(grad)
        return loss


class _SmoothnessOnGpu(NativeTerm):
    @staticmethod
    def forward(ctx: Any, values: Tensor, neighbours: Tensor) -> Tensor:
        inputs = values.contiguous(), neighbours.contiguous()
        grad, loss = torch.empty_like(inputs[0]), values.new_empty(())
        total = values.new_zeros((), dtype=torch.float64)
        counts = torch.zeros_like(inputs[0], dtype=torch.int32)
        library = _cuda_library()
        assert library is not None
        sizes = *values.shape, neighbours.shape[1]
        launch(library, "knn_smoothness", sizes, *inputs, total, counts, loss, grad)
        ctx.save_for_backward(grad)
        return loss


@cache
def _library() -> ctypes.CDLL | None:
    library = library_or_none(KERNEL, "Smoothness is found")
    if library is None:
        return None
    sizes = [*[ctypes.c_int64] * 3, ctypes.c_int]
    library.knn_smoothness.argtypes = [*sizes, *[ctypes.c_void_p] * 4]
    library.knn_smoothness.restype = ctypes.c_int
    return library


@cache
def _cuda_library() -> ctypes.CDLL | None:
    return cuda_library_or_none(CUDA_KERNEL, "Smoothness is found")
