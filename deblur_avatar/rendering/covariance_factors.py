"""Covariance factors M = R S of Gaussians, and the covariances M M^T.

Conventions. A *factor* is a Gaussian's rotation times its scales, metres; its covariance is factor
factor^T, its upper triangle xx, xy, xz, yy, yz, zz. Quaternions need not be of unit length. A
*turn* is the imaginary part of a rotation whose real part is 1, done after the Gaussian's own.

Float32 tensors go through a native kernel, on the CPU and on a GPU: in plain torch a dozen calls
over short rows take as long as the rasterization of one instant.
"""

import ctypes
from functools import cache
from pathlib import Path
from typing import Any, Final

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from deblur_avatar.geometry.rotations import quat_multiply, quat_to_matrix
from deblur_avatar.rendering.native_build import (
    UNCONTRACTED,
    library_or_none,
    pointers,
)
from deblur_avatar.rendering.native_calls import cuda_library_or_none, launch, place_of
from deblur_avatar.run import kernel_threads

KERNEL: Final = Path(__file__).with_name("covariance_factors.cpp")


def covariance_factors(
    quats: Float[Tensor, "N 4"],
    scales: Float[Tensor, "N 3"],
    turns: Float[Tensor, "N 3"] | None = None,
) -> Float[Tensor, "N 3 3"]:
    """Rotations times scales, of turned Gaussians if there are turns.

    Raises:
        ValueError: the sizes do not fit.
    """
    for name, values, width in (("scales", scales, 3), ("turns", turns, 3), ("quats", quats, 4)):
        if values is not None and values.shape != (len(quats), width):
            wanted, got = [len(quats), width], [*values.shape]
            raise ValueError(f"{name} must be {wanted}, got {got}")
    if _native(quats, scales, *([] if turns is None else [turns])):
        return _CovarianceFactors.apply(quats, scales, turns)
    return covariance_factors_reference(quats, scales, turns)


def covariance_factors_reference(
    quats: Float[Tensor, "N 4"],
    scales: Float[Tensor, "N 3"],
    turns: Float[Tensor, "N 3"] | None = None,
) -> Float[Tensor, "N 3 3"]:
    """The same in plain torch, on any device and in any precision: the kernel's slow twin."""
    if turns is not None:
        quats = quat_multiply(torch.nn.functional.pad(turns, (1, 0), value=1.0), quats)
    return quat_to_matrix(quats) * scales[:, None, :]


def covariances(covariance_factors: Float[Tensor, "N 3 3"]) -> Float[Tensor, "N 6"]:
    """Upper triangles of covariance_factors covariance_factors^T."""
    if _native(covariance_factors):
        return _Covariances.apply(covariance_factors)
    return covariances_reference(covariance_factors)


def covariances_reference(
    covariance_factors: Float[Tensor, "*batch N 3 3"],
) -> Float[Tensor, "*batch N 6"]:
    """The same in plain torch."""
    a, b, c = covariance_factors.unbind(-2)
    products = [(a, a), (a, b), (a, c), (b, b), (b, c), (c, c)]
    return torch.stack([(p * q).sum(-1) for p, q in products], dim=-1)


class _CovarianceFactors(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, quats: Tensor, scales: Tensor, turns: Tensor | None) -> Tensor:
        inputs = [None if v is None else v.contiguous() for v in (quats, scales, turns)]
        found = quats.new_empty(len(quats), 3, 3)
        _call("factors", len(quats), *inputs, found)
        ctx.save_for_backward(*inputs)
        return found

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        inputs = ctx.saved_tensors
        grads = tuple(None if value is None else torch.empty_like(value) for value in inputs)
        _call("factors_backward", len(grad), *inputs, grad.contiguous(), *grads)
        return grads


class _Covariances(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, covariance_factors: Tensor) -> Tensor:
        values = covariance_factors.contiguous()
        found = values.new_empty(len(values), 6)
        _call("covariances", len(values), values, found)
        ctx.save_for_backward(values)
        return found

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> Tensor:
        (values,) = ctx.saved_tensors
        found = torch.empty_like(values)
        _call("covariances_backward", len(values), values, grad.contiguous(), found)
        return found


def _native(*values: Tensor) -> bool:
    place = place_of(*values)
    if place == "cuda":
        return _cuda_library() is not None
    return place == "cpu" and _library() is not None


def _call(name: str, count: int, *tensors: Tensor | None) -> None:
    if place_of(*(tensor for tensor in tensors if tensor is not None)) == "cuda":
        library = _cuda_library()
        assert library is not None
        launch(library, name, [count], *tensors)
    else:
        getattr(_library(), name)(count, kernel_threads(), *pointers(*tensors))


@cache
def _library() -> ctypes.CDLL | None:
    library = library_or_none(KERNEL, "Gaussians are turned", further=UNCONTRACTED)
    if library is None:
        return None
    tensors = {"factors": 4, "factors_backward": 7, "covariances": 2, "covariances_backward": 3}
    for name, count in tensors.items():
        function = getattr(library, name)
        function.argtypes = [ctypes.c_int64, ctypes.c_int, *[ctypes.c_void_p] * count]
        function.restype = None
    return library


@cache
def _cuda_library() -> ctypes.CDLL | None:
    return cuda_library_or_none(KERNEL, "Gaussians are turned")
