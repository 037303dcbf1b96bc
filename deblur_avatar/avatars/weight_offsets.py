"""Weight offsets: a network re-weighs the blend weights of the vertex that is nearest to a point.

Conventions. Canonical space, metres. Weights are non-negative, each row sums to 1. J joints.

Source: GauHuman (Hu et al., CVPR 2024), with the numbers of its release.
"""

from collections.abc import Sequence
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn

from deblur_avatar.avatars.frequency_encoding import frequency_encoding
from deblur_avatar.geometry.nearest import nearest

# Not a parameter: GauHuman's. Joints that a vertex does not follow stay all but out of reach.
SMALLEST_WEIGHT = 1e-9


class WeightOffsets(nn.Module):
    """Offsets of the logarithms of blend weights, by where a point is; 0 at first."""

    def __init__(self, joints: int, frequencies: int, hidden: Sequence[int]) -> None:
        """A network of ReLU layers.

        Args:
            joints: how many.
            frequencies: of the encoding of positions.
            hidden: widths; the last layer of them sees the encoding once more. At least two.
        """
        super().__init__()
        self._frequencies = frequencies
        encoded = 3 * (1 + 2 * frequencies)
        sizes = [encoded, *hidden[:-1]]
        layers = [nn.Sequential(nn.Linear(a, b), nn.ReLU()) for a, b in pairwise(sizes)]
        self.layers = nn.Sequential(*layers)
        self.again = nn.Linear(sizes[-1] + encoded, hidden[-1])
        self.last = nn.Linear(hidden[-1], joints)
        nn.init.zeros_(self.last.weight)
        nn.init.zeros_(self.last.bias)

    def forward(
        self, points: Float[Tensor, "N 3"], nearest: Float[Tensor, "N J"]
    ) -> Float[Tensor, "N J"]:
        """Weights at points; no gradient flows back to where these are.

        Args:
            points: canonical positions.
            nearest: weights of the vertex nearest to each.
        """
        encoded = encoded_positions(points.detach(), self._frequencies)
        value = torch.cat([self.layers(encoded), encoded], dim=1)
        offsets = self.last(self.again(value).relu())
        return ((nearest + SMALLEST_WEIGHT).log() + offsets).softmax(dim=1)


def encoded_positions(points: Float[Tensor, "N 3"], frequencies: int) -> Float[Tensor, "N E"]:
    """Positions, all their sines, all their cosines: the order that saved networks know."""
    waves = frequency_encoding(points, frequencies).unflatten(1, (frequencies, 2, 3))
    return torch.cat([points, waves.transpose(1, 2).flatten(1)], dim=1)


def nearest_weights(
    points: Float[Tensor, "N 3"], vertices: Float[Tensor, "V 3"], lbs_weights: Float[Tensor, "V J"]
) -> Float[Tensor, "N J"]:
    """Weights of the vertex that is nearest to each point."""
    return lbs_weights.to(points)[nearest(points, vertices).indices[:, 0]]
