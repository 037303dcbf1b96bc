"""Cubic B-spline of poses: rotations and translation at some times, and how far its knots moved.

Conventions. Those of `geometry.splines`, times in units of the knots' spacing. K knots, J joints,
M times.

Float32 tensors on the CPU go through a native kernel: an evaluation with its gradient is hundreds
of calls over short rows in plain torch, a third of a step where one instant is rendered
(docs/decisions/0046-parsimony.md).
"""

import ctypes
from functools import cache
from pathlib import Path
from typing import Any, Final

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from deblur_avatar.geometry.rotations import (
    SMALL_ANGLE,
    axis_angle_to_quat,
    quat_conjugate,
    quat_multiply,
    quat_to_axis_angle,
)
from deblur_avatar.geometry.splines import spline_points, spline_quats
from deblur_avatar.rendering.native_build import library_or_none, pointers

KERNEL: Final = Path(__file__).with_name("pose_spline.cpp")


def pose_spline(
    axis_angle: Float[Tensor, "K J 3"],
    transl: Float[Tensor, "K 3"],
    times: Float[Tensor, " M"],
) -> tuple[Float[Tensor, "M J 4"], Float[Tensor, "M 3"]]:
    """Unit quaternions of the joints, and the translation, at some times.

    Source: as `geometry.splines.spline_quats`.
    """
    if _native(axis_angle, transl, times):
        return _PoseSpline.apply(axis_angle, transl, times)
    return pose_spline_reference(axis_angle, transl, times)


def pose_spline_reference(
    axis_angle: Float[Tensor, "K J 3"],
    transl: Float[Tensor, "K 3"],
    times: Float[Tensor, " M"],
) -> tuple[Float[Tensor, "M J 4"], Float[Tensor, "M 3"]]:
    """The same in plain torch, on any device and in any precision: the kernel's slow twin."""
    quats = spline_quats(axis_angle_to_quat(axis_angle), times)
    return quats, spline_points(transl, times)


def knot_distance(
    axis_angle: Float[Tensor, "K J 3"],
    transl: Float[Tensor, "K 3"],
    others: tuple[Float[Tensor, "K J 3"], Float[Tensor, "K 3"]],
    lever: float,
) -> Float[Tensor, ""]:
    """Mean squared turn from other knots, plus mean squared shift in units of a lever; 0 of none.

    Args:
        axis_angle: of the joints, radians.
        transl: metres.
        others: rotations and translations of as many knots, without gradient.
        lever: metres that count as a radian.
    """
    if _native(axis_angle, transl, *others):
        return _KnotDistance.apply(axis_angle, transl, *others, lever)
    return knot_distance_reference(axis_angle, transl, others, lever)


def knot_distance_reference(
    axis_angle: Float[Tensor, "K J 3"],
    transl: Float[Tensor, "K 3"],
    others: tuple[Float[Tensor, "K J 3"], Float[Tensor, "K 3"]],
    lever: float,
) -> Float[Tensor, ""]:
    """The same in plain torch: the kernel's slow twin."""
    quats, first = axis_angle_to_quat(axis_angle), axis_angle_to_quat(others[0])
    turns = quat_to_axis_angle(quat_multiply(quat_conjugate(first), quats))
    return _mean_squared_length(turns) + _mean_squared_length((transl - others[1]) / lever)


def _mean_squared_length(vectors: Float[Tensor, "*batch 3"]) -> Float[Tensor, ""]:
    return vectors.square().sum(-1).sum() / max(vectors[..., 0].numel(), 1)


class _PoseSpline(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, axis_angle: Tensor, transl: Tensor, times: Tensor
    ) -> tuple[Tensor, Tensor]:
        inputs = axis_angle.contiguous(), transl.contiguous(), times.contiguous()
        ctx.save_for_backward(*inputs)
        ctx.sizes = *axis_angle.shape[:2], len(times)
        found = (
            axis_angle.new_empty(len(times), axis_angle.shape[1], 4),
            axis_angle.new_empty(len(times), 3),
        )
        _call("pose_spline", *ctx.sizes, *pointers(*inputs, *found))
        return found

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, quats_grad: Tensor, transl_grad: Tensor) -> tuple[Tensor | None, ...]:
        inputs = ctx.saved_tensors
        given = quats_grad.contiguous(), transl_grad.contiguous()
        grads = tuple(
            torch.empty_like(value) if needed else None
            for value, needed in zip(inputs, (True, True, ctx.needs_input_grad[2]), strict=True)
        )
        _call("pose_spline_backward", *ctx.sizes, *pointers(*inputs, *given, *grads))
        return grads


class _KnotDistance(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, axis_angle: Tensor, transl: Tensor, others: Tensor, shifts: Tensor, lever: float
    ) -> Tensor:
        inputs = [value.contiguous() for value in (axis_angle, transl, others, shifts)]
        grads = [torch.empty_like(value) for value in inputs[:2]]
        distance = axis_angle.new_empty(())
        sizes = *axis_angle.shape[:2], lever
        _call("knot_distance", *sizes, *pointers(*inputs, distance, *grads))
        ctx.save_for_backward(*grads)
        return distance

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:
        axis_angle_grad, transl_grad = ctx.saved_tensors
        return upstream * axis_angle_grad, upstream * transl_grad, None, None, None


def _native(*values: Tensor) -> bool:
    fit = all(v.device.type == "cpu" and v.dtype == torch.float32 for v in values)
    return fit and _library() is not None


def _call(name: str, *arguments: Any) -> None:
    getattr(_library(), name)(*arguments)


@cache
def _library() -> ctypes.CDLL | None:
    library = library_or_none(KERNEL, "Trajectories are found", [f"SMALL_ANGLE={SMALL_ANGLE}"])
    if library is None:
        return None
    last_size = {"knot_distance": ctypes.c_double}
    tensors = {"pose_spline": 5, "pose_spline_backward": 8, "knot_distance": 7}
    for name, count in tensors.items():
        function = getattr(library, name)
        sizes = [ctypes.c_int64, ctypes.c_int64, last_size.get(name, ctypes.c_int64)]
        function.argtypes = [*sizes, *[ctypes.c_void_p] * count]
        function.restype = None
    return library
