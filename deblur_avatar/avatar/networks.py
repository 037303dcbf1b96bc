"""Small networks over many points that share one condition.

A condition (pose code, frame code) is the same for every point, so its share of the first layer is
computed once and added, instead of being copied to every point.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

LEAKY_SLOPE = 0.01  # 3DGS-Avatar


class ConditionedMLP(nn.Module):
    """Leaky-ReLU layers over points [P, inputs], with a condition [C] at the first layer.

    Source: 3DGS-Avatar's and Deblur-Avatar's deformation and colour networks.
    """

    def __init__(self, inputs: int, condition: int, hidden: Sequence[int], outputs: int) -> None:
        super().__init__()
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
        value = torch.addmm(bias, points, first.weight[:, : self._inputs].T)
        for layer in self.layers[1:]:
            value = layer(nn.functional.leaky_relu(value, LEAKY_SLOPE, inplace=True))
        return self.last(nn.functional.leaky_relu(value, LEAKY_SLOPE, inplace=True))


def one_blob(points: Float[Tensor, "P 3"], bins: int) -> Float[Tensor, "P E"]:
    """Encode positions in [0, 1] by how much of a smooth bump falls into each bin of each axis.

    Source: Mueller et al., "Neural Importance Sampling", 2019, with the quartic kernel of
    tiny-cuda-nn, which is what 3DGS-Avatar's configuration resolves to.
    """
    edges = torch.arange(bins + 1, dtype=points.dtype, device=points.device)
    # Distance from the point to every edge in bins; the kernel's radius is one bin.
    distance = (edges - points[..., None] * bins).clamp(-1, 1)
    squared = distance * distance
    cumulative = 0.5 + distance * (15 - 10 * squared + 3 * squared * squared) / 16
    return cumulative.diff(dim=-1).flatten(-2)


def spherical_harmonics(directions: Float[Tensor, "P 3"]) -> Float[Tensor, "P 15"]:
    """Real spherical harmonics of degrees 1 to 3 of unit directions.

    Source: the usual real basis (Sloan, "Stupid Spherical Harmonics Tricks", 2008), no DC term.
    """
    x, y, z = directions.unbind(-1)
    xx, yy, zz = x * x, y * y, z * z
    return torch.stack(
        [
            -0.48860251190292 * y,
            0.48860251190292 * z,
            -0.48860251190292 * x,
            1.09254843059208 * x * y,
            -1.09254843059208 * y * z,
            0.94617469575756 * zz - 0.31539156525252,
            -1.09254843059208 * x * z,
            0.54627421529604 * (xx - yy),
            0.59004358992664 * y * (yy - 3 * xx),
            2.89061144264055 * x * y * z,
            0.45704579946446 * y * (1 - 5 * zz),
            0.37317633259011 * z * (5 * zz - 3),
            0.45704579946446 * x * (1 - 5 * zz),
            1.44530572132028 * z * (xx - yy),
            0.59004358992664 * x * (3 * yy - xx),
        ],
        -1,
    )
