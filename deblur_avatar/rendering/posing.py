"""Linear blend skinning of Gaussians: posed means and covariances in B poses at once.

Conventions. Covariance factors and covariances are those of `covariance_factors`. Transforms go
from canonical to posed.

Float32 tensors are posed by a native kernel, one for the CPU and one for a GPU: in plain torch this
step costs several times the rasterization it feeds (docs/decisions/0004-posing-kernel.md).
"""

import ctypes
from functools import cache
from pathlib import Path
from typing import Any, Final

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.utils.weak import WeakTensorKeyDictionary

from deblur_avatar.rendering.covariances import upper_triangles
from deblur_avatar.rendering.native_build import (
    library_or_none,
    pointers,
)
from deblur_avatar.rendering.native_calls import cuda_library_or_none, launch, place_of
from deblur_avatar.run import kernel_threads

KERNEL: Final = Path(__file__).with_name("posing.cpp")
CUDA_KERNEL: Final = Path(__file__).with_name("posing.cu")

# Groups of weights that are still held by someone, and the version of the weights they are of.
_KNOWN: Final = WeakTensorKeyDictionary()


def pose_gaussians(
    means: Float[Tensor, "N 3"],
    covariance_factors: Float[Tensor, "N 3 3"],
    lbs_weights: Float[Tensor, "N J"],
    transforms: Float[Tensor, "B J 4 4"],
) -> tuple[Float[Tensor, "B N 3"], Float[Tensor, "B N 6"]]:
    """Skin Gaussians: posed means, and the upper triangles of posed covariances.

    The blended rotation is not made orthonormal again: covariances stretch as the skin does.

    Raises:
        ValueError: if there are other factors or weights than means, or other joints than weights.

    Source: 3DGS-Avatar, Qian et al., CVPR 2024, eq. 6-7.
    """
    given = (means, covariance_factors, lbs_weights, transforms)
    place = place_of(*given)
    if place == "cpu" and _library() is not None:
        _check_shapes(*given)
        return _Posing.apply(*given)
    if place == "cuda" and _cuda_library() is not None:
        _check_shapes(*given)
        return _PosingOnGpu.apply(*given)
    return pose_gaussians_reference(means, covariance_factors, lbs_weights, transforms)


def pose_gaussians_reference(
    means: Float[Tensor, "N 3"],
    covariance_factors: Float[Tensor, "N 3 3"],
    lbs_weights: Float[Tensor, "N J"],
    transforms: Float[Tensor, "B J 4 4"],
) -> tuple[Float[Tensor, "B N 3"], Float[Tensor, "B N 6"]]:
    """The same in plain torch, on any device and in any precision: the kernel's slow twin."""
    # One product for all poses and few calls, since each is one that a GPU has to be asked for.
    rows = transforms[:, :, :3].permute(1, 0, 2, 3)
    blended = (lbs_weights @ rows.flatten(1)).unflatten(1, rows.shape[1:]).transpose(0, 1)
    posed = (blended[..., :3] @ means[:, :, None])[..., 0] + blended[..., 3]
    turned = blended[..., :3] @ covariance_factors
    return posed, upper_triangles(turned @ turned.mT)


def _check_shapes(
    means: Tensor, covariance_factors: Tensor, lbs_weights: Tensor, transforms: Tensor
) -> None:
    count, joints = len(means), transforms.shape[1]
    if covariance_factors.shape != (count, 3, 3) or lbs_weights.shape != (count, joints):
        raise ValueError(
            f"{count} means and {joints} joints' transforms want covariance_factors {count, 3, 3} "
            f"and lbs_weights {count, joints}, not {tuple(covariance_factors.shape)} "
            f"and {tuple(lbs_weights.shape)}"
        )


class _Posing(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, means: Tensor, covariance_factors: Tensor, lbs_weights: Tensor, transforms: Tensor
    ) -> tuple[Tensor, Tensor]:
        poses, joints = transforms.shape[:2]
        # One row of 12 B numbers a joint.
        rows = transforms[:, :, :3].permute(1, 0, 2, 3).contiguous()
        count = len(means)
        sizes = (poses, count, joints, kernel_threads())
        library = _library()
        assert library is not None
        groups = _groups_of(library, lbs_weights)
        inputs = [means.contiguous(), covariance_factors.contiguous(), *groups, rows]
        posed = means.new_empty(poses, count, 3), means.new_empty(poses, count, 6)
        library.pose(*sizes, *pointers(*inputs, *posed))
        ctx.save_for_backward(*inputs)
        ctx.sizes = sizes
        return posed

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, means_grad: Tensor, covars_grad: Tensor) -> tuple[Tensor | None, ...]:
        inputs = ctx.saved_tensors
        means, covariance_factors, *_, rows = inputs
        poses, count, joints, _ = ctx.sizes
        library = _library()
        assert library is not None
        grads = [torch.empty_like(means), torch.empty_like(covariance_factors)]
        wanted = ctx.needs_input_grad[2]  # not where weights are the body's own
        weights_grad = means.new_empty(count, joints) if wanted else None
        partials = means.new_empty(library.chunks(count), joints, poses, 12)
        rows_grad = torch.empty_like(rows)
        upstream = means_grad.contiguous(), covars_grad.contiguous()
        library.pose_backward(
            *ctx.sizes, *pointers(*inputs, *upstream, *grads, weights_grad, partials, rows_grad)
        )
        transforms_grad = torch.nn.functional.pad(rows_grad.permute(1, 0, 2, 3), (0, 0, 0, 1))
        return *grads, weights_grad, transforms_grad


class _PosingOnGpu(torch.autograd.Function):
    """Blending, and what transforms and weights gain of its gradient, are products of matrices."""

    @staticmethod
    def forward(
        ctx: Any, means: Tensor, covariance_factors: Tensor, lbs_weights: Tensor, transforms: Tensor
    ) -> tuple[Tensor, Tensor]:
        poses, count = len(transforms), len(means)
        rows = transforms[:, :, :3].permute(1, 0, 2, 3).flatten(1)  # 12 B numbers a joint
        blended = lbs_weights @ rows
        inputs = means.contiguous(), covariance_factors.contiguous(), blended
        posed = means.new_empty(poses, count, 3), means.new_empty(poses, count, 6)
        library = _cuda_library()
        assert library is not None
        launch(library, "pose", [poses, count], *inputs, *posed)
        ctx.save_for_backward(*inputs, lbs_weights, rows)
        ctx.poses = poses
        return posed

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, means_grad: Tensor, covars_grad: Tensor) -> tuple[Tensor | None, ...]:
        means, covariance_factors, blended, lbs_weights, rows = ctx.saved_tensors
        inputs = means, covariance_factors, blended
        upstream = means_grad.contiguous(), covars_grad.contiguous()
        *grads, blended_grad = [torch.empty_like(value) for value in inputs]
        library = _cuda_library()
        assert library is not None
        sizes = ctx.poses, len(means)
        launch(library, "pose_backward", sizes, *inputs, *upstream, *grads, blended_grad)
        weights_grad = blended_grad @ rows.T if ctx.needs_input_grad[2] else None
        rows_grad = (lbs_weights.T @ blended_grad).unflatten(1, (ctx.poses, 3, 4))
        transforms_grad = torch.nn.functional.pad(rows_grad.transpose(0, 1), (0, 0, 0, 1))
        return *grads, weights_grad, transforms_grad


def _groups_of(library: ctypes.CDLL, lbs_weights: Tensor) -> list[Tensor]:
    """What `_grouped` finds, once for weights that are not learned: a fit keeps them many steps."""
    if lbs_weights.requires_grad:
        return _grouped(library, lbs_weights.contiguous())
    version, groups = _KNOWN.get(lbs_weights, (None, []))
    if version != lbs_weights._version:
        groups = _grouped(library, lbs_weights.contiguous())
        _KNOWN[lbs_weights] = lbs_weights._version, groups
    return groups


def _grouped(library: ctypes.CDLL, lbs_weights: Tensor) -> list[Tensor]:
    """Which Gaussians are posed together, and the joints that each group of them follows.

    Places of Gaussians, ends of each group's joints, joints, weights; what no group has is not set.
    """
    count, joints = lbs_weights.shape
    groups = library.groups(count)
    found = [
        torch.empty(count, dtype=torch.int32),
        torch.empty(groups, dtype=torch.int64),
        torch.empty(groups, joints, dtype=torch.int32),
        lbs_weights.new_empty(groups, joints, library.lanes()),
    ]
    sizes = count, joints, kernel_threads()
    library.group_by_joint(*sizes, *pointers(lbs_weights, *found))
    return found


@cache
def _library() -> ctypes.CDLL | None:
    library = library_or_none(KERNEL, "Gaussians are posed")
    if library is None:
        return None
    integers = {"group_by_joint": 2, "pose": 3, "pose_backward": 3}  # sizes, before the threads
    tensors = {"group_by_joint": 5, "pose": 9, "pose_backward": 14}
    for name, count in tensors.items():
        function = getattr(library, name)
        sizes = [*[ctypes.c_int64] * integers[name], ctypes.c_int]
        function.argtypes = [*sizes, *[ctypes.c_void_p] * count]
        function.restype = None
    for name in ("chunks", "groups"):
        getattr(library, name).argtypes = [ctypes.c_int64]
    for name in ("chunks", "groups", "lanes"):
        getattr(library, name).restype = ctypes.c_int64
    return library


@cache
def _cuda_library() -> ctypes.CDLL | None:
    return cuda_library_or_none(CUDA_KERNEL, "Gaussians are posed")
