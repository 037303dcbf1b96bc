"""Leaky-ReLU layers in bfloat16 on processors that multiply it natively.

Conventions. P points. Activations and gradients are bfloat16 (each off by at most 1/256), sums are
float32, and so are weights outside, narrow inputs (coordinates need all their digits) and the last
layer's output. Five times faster than the same layers in float32, which is most of a fitting step
(docs/decisions/0007-half-precision-layers.md).
"""

from collections.abc import Sequence
from functools import cache
from typing import Any, Final

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

HALF: Final = torch.bfloat16
NARROW: Final = 16  # inputs


def worthwhile(points: Tensor) -> bool:
    """Whether layers over these points are to be computed in half precision."""
    return points.dtype == torch.float32 and points.device.type == "cpu" and _multiplies_half()


def leaky_layers(
    points: Float[Tensor, "P I"],
    weights: Sequence[Float[Tensor, "_ _"]],
    biases: Sequence[Float[Tensor, " _"]],
    slope: float,
) -> Float[Tensor, "P O"]:
    """Layers with leaky ReLUs of this slope between them."""
    return _Layers.apply(slope, points, *weights, *biases)


class _Layers(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, slope: float, points: Tensor, *parameters: Tensor) -> Tensor:
        count = len(parameters) // 2
        weights, biases = parameters[:count], parameters[count:]
        value = points if points.shape[1] < NARROW else points.to(HALF)
        halves, inputs = [], []
        for weight, bias in zip(weights[:-1], biases[:-1], strict=True):
            inputs.append(value.to(HALF))
            halves.append(weight.to(HALF))
            weight = halves[-1] if value.dtype == HALF else weight
            value = _linear(value, weight, bias.to(value.dtype), slope).to(HALF)
        inputs.append(value)
        halves.append(weights[-1].to(HALF))
        ctx.slope = slope
        ctx.save_for_backward(*inputs, *halves)
        return _linear(value.float(), weights[-1], biases[-1], None)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        count = len(ctx.saved_tensors) // 2
        inputs, weights = ctx.saved_tensors[:count], ctx.saved_tensors[count:]
        back = grad.to(HALF)
        ones = back.new_ones(1, len(back))
        weight_grads: list[Tensor] = []
        bias_grads: list[Tensor] = []
        for layer in reversed(range(count)):
            weight_grads.insert(0, (back.T @ inputs[layer]).float())
            bias_grads.insert(0, (ones @ back)[0].float())
            if layer == 0 and not ctx.needs_input_grad[1]:
                return None, None, *weight_grads, *bias_grads
            back = _times(back, weights[layer])
            if layer > 0:
                # In place: most of this is memory.
                torch.ops.aten.leaky_relu_backward.grad_input(
                    back, inputs[layer], ctx.slope, True, grad_input=back
                )
        return None, back.float(), *weight_grads, *bias_grads


def _linear(value: Tensor, weight: Tensor, bias: Tensor, slope: float | None) -> Tensor:
    kind, scalars = ("none", []) if slope is None else ("leaky_relu", [slope])
    return torch.ops.mkldnn._linear_pointwise(value, weight.contiguous(), bias, kind, scalars, "")


def _times(grad: Tensor, weight: Tensor) -> Tensor:
    # A product with one row is a matter of memory, which the library for products does not see.
    return grad * weight if len(weight) == 1 else grad @ weight


@cache
def _multiplies_half() -> bool:
    able = torch.cpu.get_capabilities()
    native = bool(able.get("avx512_bf16") or able.get("amx_bf16"))
    return native and torch.backends.mkldnn.is_available()
