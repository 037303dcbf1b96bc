"""Small networks over many points that share one condition.

A condition (pose code, frame code) is the same for every point, so its share of the first layer is
computed once and added, instead of being copied to every point.
"""

from collections.abc import Mapping, Sequence
from functools import cache
from itertools import permutations
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from deblur_avatar.avatars.half_precision import leaky_layers
from deblur_avatar.avatars.params import Precision

LEAKY_SLOPE = 0.01  # 3DGS-Avatar, and PyTorch's own; saved networks are of this slope


class ConditionedMLP(nn.Module):
    """Leaky-ReLU layers over points [P, inputs], with a condition [C] at the first layer.

    In float64 it computes in float64, whatever its precision: derivatives are checked so.

    Source: 3DGS-Avatar's and Deblur-Avatar's deformation and colour networks.
    """

    def __init__(
        self, inputs: int, condition: int, hidden: Sequence[int], outputs: int,
        precision: Precision,
    ) -> None:  # fmt: skip
        super().__init__()
        self._precision = precision
        sizes = [inputs + condition, *hidden]
        self._inputs = inputs
        self.layers = nn.ModuleList(nn.Linear(a, b) for a, b in zip(sizes, sizes[1:], strict=False))
        self.last = nn.Linear(sizes[-1], outputs)

    def forward(
        self, points: Float[Tensor, "P I"], condition: Float[Tensor, " C"] | None = None
    ) -> Float[Tensor, "P O"]:
        """Evaluate at every point."""
        first = self.layers[0]
        assert isinstance(first, nn.Linear)
        bias: Tensor = first.bias
        if condition is not None:
            bias = bias + first.weight[:, self._inputs :] @ condition
        weight = first.weight[:, : self._inputs]
        if self._precision == "bfloat16" and points.dtype == torch.float32:
            others = [*self.layers[1:], self.last]
            weights = [weight, *(layer.weight for layer in others)]
            return leaky_layers(points, weights, [bias, *(b.bias for b in others)], LEAKY_SLOPE)
        value = torch.addmm(bias, points, weight.T)
        for layer in self.layers[1:]:
            value = layer(nn.functional.leaky_relu(value, LEAKY_SLOPE, inplace=True))
        return self.last(nn.functional.leaky_relu(value, LEAKY_SLOPE, inplace=True))


def one_blob(points: Float[Tensor, "P 3"], bins: int) -> Float[Tensor, "P E"]:
    """Encode positions in [0, 1] by how much of a smooth bump falls into each bin of each axis.

    Source: Mueller et al., "Neural Importance Sampling", 2019, with the quartic kernel of
    tiny-cuda-nn, which is what 3DGS-Avatar's configuration resolves to.
    """
    return _OneBlob.apply(points, bins)


class _OneBlob(torch.autograd.Function):
    # The gradient is by hand: autograd goes over P x 3 x bins numbers more often.
    @staticmethod
    def forward(ctx: Any, points: Tensor, bins: int) -> Tensor:
        edges = torch.arange(bins + 1, dtype=points.dtype, device=points.device)
        # Distance from the point to every edge in bins; the kernel's radius is one bin.
        distance = (edges - points[..., None] * bins).clamp(-1, 1)
        ctx.save_for_backward(distance)
        ctx.bins = bins
        squared = distance.square()
        cumulative = distance * ((3 * squared - 10) * squared + 15) / 16
        return cumulative.diff(dim=-1).flatten(-2)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None]:
        (distance,) = ctx.saved_tensors
        bump = (1 - distance.square()).square()
        each = grad.unflatten(-1, (-1, ctx.bins)) * bump.diff(dim=-1)
        return each.sum(-1) * (-15 / 16 * ctx.bins), None


def spherical_harmonics(directions: Float[Tensor, "P 3"]) -> Float[Tensor, "P 15"]:
    """Real spherical harmonics of degrees 1 to 3 of unit directions.

    Source: the usual real basis (Sloan, "Stupid Spherical Harmonics Tricks", 2008), no DC term.
    """
    return _Harmonics.apply(directions)


class _Harmonics(torch.autograd.Function):
    # A product of k coordinates d_i d_j d_k, of which all orders count alike, changes with d_i as
    # k times the product of the others: forward and backward share the products of up to two.
    @staticmethod
    def forward(ctx: Any, directions: Tensor) -> Tensor:
        second = (directions[:, :, None] * directions[:, None, :]).flatten(1)
        fewer = torch.cat([torch.ones_like(directions[:, :1]), directions, second], dim=1)
        ctx.save_for_backward(fewer)
        products = (directions[:, :, None] * fewer[:, None, :]).flatten(1)
        return products @ _harmonics(directions.dtype, directions.device)[0]

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> Tensor:
        (fewer,) = ctx.saved_tensors
        slopes = grad @ _harmonics(grad.dtype, grad.device)[1].T
        return (slopes.unflatten(1, (3, -1)) * fewer[:, None, :]).sum(-1)


# Each harmonic as factor times monomial of x, y, z on the unit sphere, where 1 = xx + yy + zz.
_HARMONICS: Sequence[Mapping[str, float]] = (
    {"y": -0.48860251190292},
    {"z": 0.48860251190292},
    {"x": -0.48860251190292},
    {"xy": 1.09254843059208},
    {"yz": -1.09254843059208},
    {"zz": 0.63078313050504, "xx": -0.31539156525252, "yy": -0.31539156525252},
    {"xz": -1.09254843059208},
    {"xx": 0.54627421529604, "yy": -0.54627421529604},
    {"yyy": 0.59004358992664, "xxy": -1.77013076977993},
    {"xyz": 2.89061144264055},
    {"xxy": 0.45704579946446, "yyy": 0.45704579946446, "yzz": -1.82818319785784},
    {"zzz": 0.74635266518022, "xxz": -1.11952899777034, "yyz": -1.11952899777034},
    {"xxx": 0.45704579946446, "xyy": 0.45704579946446, "xzz": -1.82818319785784},
    {"xxz": 1.44530572132028, "yyz": -1.44530572132028},
    {"xyy": 1.77013076977993, "xxx": -0.59004358992664},
)


@cache
def _harmonics(dtype: torch.dtype, device: torch.device) -> tuple[Tensor, Tensor]:
    """Factors of the 39 products of up to three coordinates, one column a harmonic; and slopes'.

    Rows are in the order of the first coordinate, then of the product of the others: 1, x, y, z,
    xx, xy, ... zz. A product's factor is shared evenly among its orders.
    """
    table = torch.zeros(3, 1 + 3 + 9, len(_HARMONICS), dtype=dtype)
    for column, terms in enumerate(_HARMONICS):
        for monomial, factor in terms.items():
            orders = list(permutations("xyz".index(letter) for letter in monomial))
            for first, *others in orders:
                row = (0, 1, 4)[len(others)] + sum(
                    3**place * other for place, other in enumerate(reversed(others))
                )
                table[first, row, column] += factor / len(orders)
    degrees = torch.tensor([1] + 3 * [2] + 9 * [3], dtype=dtype)[:, None]
    return table.flatten(0, 1).to(device), (table * degrees).flatten(0, 1).to(device)
