"""Leaky-ReLU layers whose products are of bfloat16 numbers.

Conventions. P points. Inputs, hidden weights, activations and gradients are rounded to bfloat16
(each off by at most 1/256). Sums are float32, and so are weights outside, narrow inputs
(coordinates need all their digits) and the last layer's output.

On a processor that multiplies bfloat16 natively this is five times faster than the same layers in
float32, which is most of a fitting step (docs/decisions/0007). Elsewhere the same numbers are
rounded at the same places and multiplied in float32 (0018). The two differ where sums in another
order are rounded to the other neighbour.
"""

from collections.abc import Sequence
from functools import cache
from typing import Any, Final

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from deblur_avatar.avatars.params import Precision

HALF: Final = torch.bfloat16
NARROW: Final = 16  # inputs; fewer are coordinates, which need all digits


def leaky_layers(
    points: Float[Tensor, "P I"],
    weights: Sequence[Float[Tensor, "_ _"]],
    biases: Sequence[Float[Tensor, " _"]],
    slope: float,
) -> Float[Tensor, "P O"]:
    """Layers with leaky ReLUs of this slope between them, of float32 tensors."""
    return _Layers.apply(slope, points, *weights, *biases)


def as_computed(precision: Precision | None, device: torch.device) -> dict[str, str]:
    """How networks of a precision (None: no networks) are computed here, for a record of a run.

    Returns:
        `precision`: float32, "bfloat16, native" or "bfloat16, emulated"; and `cpu`, the widest
        vector instructions that torch uses: AVX512, AVX2 or DEFAULT.
    """
    way = "native" if is_native(device) else "emulated"
    name = f"bfloat16, {way}" if precision == "bfloat16" else "float32"
    return {"precision": name, "cpu": torch.backends.cpu.get_cpu_capability()}


def is_native(device: torch.device) -> bool:
    """Whether bfloat16 is multiplied as such on a device, or emulated in float32."""
    return device.type == "cpu" and _multiplies_half()


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
            weight_grads.insert(0, _product(back.T, inputs[layer]).float())
            bias_grads.insert(0, _product(ones, back)[0].float())
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
    if value.dtype == HALF and not is_native(value.device):
        return _linear(value.float(), weight.float(), bias.float(), slope).to(HALF)
    if value.device.type != "cpu" or not torch.backends.mkldnn.is_available():
        sums = torch.addmm(bias, value, weight.T)
        return sums if slope is None else torch.nn.functional.leaky_relu_(sums, slope)
    kind, scalars = ("none", []) if slope is None else ("leaky_relu", [slope])
    return torch.ops.mkldnn._linear_pointwise(value, weight.contiguous(), bias, kind, scalars, "")


def _times(grad: Tensor, weight: Tensor) -> Tensor:
    # A product with one row is a matter of memory, which the library for products does not see.
    return grad * weight if len(weight) == 1 else _product(grad, weight)


def _product(left: Tensor, right: Tensor) -> Tensor:
    if is_native(left.device):
        return left @ right
    return (left.float() @ right.float()).to(HALF)


@cache
def _multiplies_half() -> bool:
    able = torch.cpu.get_capabilities()
    native = bool(able.get("avx512_bf16") or able.get("amx_bf16"))
    # ATEN_CPU_CAPABILITY tells torch to do without what the processor has.
    allowed = torch.backends.cpu.get_cpu_capability().startswith("AVX512")
    return native and allowed and torch.backends.mkldnn.is_available()
