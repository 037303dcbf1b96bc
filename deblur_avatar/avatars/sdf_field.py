"""Signed distance field: how far a canonical point is from the surface, negative inside.

A network of sines whose layers a condition stretches and shifts (FiLM), so that the surface depends
on the pose. Densities follow from distances by one learned width.

Conventions. Canonical space, metres; the network sees it scaled to [-1, 1]. P points.

Source: SIREN (Sitzmann et al., NeurIPS 2020), its modulation as in pi-GAN (Chan et al., CVPR 2021)
and ARAH (Wang et al., ECCV 2022); densities of VolSDF (Yariv et al., NeurIPS 2021).
"""

from collections.abc import Sequence
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn

SLOPE = 0.2  # of the leaky ReLU between condition and modulation: the release's
PADDING = 0.05  # of the body's largest extent, round the box that is [-1, 1]: the release's

# Of each layer: what it is multiplied by, and what is added.
Modulation = list[tuple[Tensor, Tensor]]


class SdfField(nn.Module):
    """Sine layers over points, modulated by a condition; at first by none, whatever it is."""

    centre: Tensor
    half_size: Tensor

    def __init__(
        self,
        vertices: Float[Tensor, "V 3"],
        condition: int,
        hidden: Sequence[int],
        frequency: float,
        generator: torch.Generator | None = None,
    ) -> None:
        """Draw weights as SIREN's.

        Args:
            vertices: of the canonical body, which the box is round.
            condition: numbers of the condition.
            hidden: units of each hidden layer.
            frequency: by which phases are multiplied.
            generator: of the weights; None for the process's own.
        """
        super().__init__()
        low, high = vertices.amin(0), vertices.amax(0)
        half = (high - low).max() / 2 * (1 + 2 * PADDING)
        self.register_buffer("centre", (low + high) / 2, persistent=False)
        self.register_buffer("half_size", half, persistent=False)
        self._frequency, self._hidden = frequency, tuple(hidden)
        self.layers = nn.ModuleList(nn.Linear(*size) for size in pairwise([3, *hidden, 1]))
        for index, layer in enumerate(self._linear()):
            inputs = layer.in_features
            bound = 1 / inputs if index == 0 else (6 / inputs) ** 0.5 / frequency
            nn.init.uniform_(layer.weight, -bound, bound, generator=generator)
            nn.init.uniform_(layer.bias, -(inputs**-0.5), inputs**-0.5, generator=generator)
        nn.init.zeros_(self._linear()[-1].bias)
        self.seen = nn.Linear(condition, hidden[-1])
        self.modulation = nn.Linear(hidden[-1], 2 * sum(hidden))
        nn.init.xavier_uniform_(self.seen.weight, generator=generator)
        for silent in (self.seen.bias, self.modulation.weight, self.modulation.bias):
            nn.init.zeros_(silent)

    def modulated(self, condition: Float[Tensor, " C"]) -> Modulation:
        """How a condition stretches and shifts each layer."""
        seen = nn.functional.leaky_relu(self.seen(condition), SLOPE)
        stretch, shift = self.modulation(seen).chunk(2)
        parts = zip(stretch.split(self._hidden), shift.split(self._hidden), strict=True)
        return [(1 + more, added) for more, added in parts]

    def forward(
        self, points: Float[Tensor, "P 3"], modulation: Modulation
    ) -> tuple[Float[Tensor, " P"], Float[Tensor, "P H"]]:
        """Distances, metres, and what the last hidden layer knows of the points."""
        *hidden, last = self._linear()
        value = (points - self.centre) / self.half_size
        for layer, (stretch, shift) in zip(hidden, modulation, strict=True):
            value = (self._frequency * (stretch * layer(value) + shift)).sin()
        return last(value)[:, 0] * self.half_size, value

    def normals(
        self, points: Float[Tensor, "P 3"], modulation: Modulation
    ) -> tuple[Float[Tensor, " P"], Float[Tensor, "P H"], Float[Tensor, "P 3"]]:
        """Distances, features and the distances' gradients, differentiable where gradients are."""
        differentiable = torch.is_grad_enabled()
        with torch.enable_grad():
            points = points if points.requires_grad else points.detach().requires_grad_()
            distances, features = self(points, modulation)
            gradients = torch.autograd.grad(
                distances.sum(), points, create_graph=differentiable, retain_graph=differentiable
            )[0]
        if differentiable:
            return distances, features, gradients
        return distances.detach(), features.detach(), gradients

    def _linear(self) -> list[nn.Linear]:
        return [layer for layer in self.layers if isinstance(layer, nn.Linear)]


def density(
    distances: Float[Tensor, "*batch"], width: Float[Tensor, ""]
) -> Float[Tensor, "*batch"]:
    """Laplace's distribution over distances, per metre: 1 / width deep inside, half of it on the
    surface, nothing far outside.
    """
    # Of the magnitude alone, so that the half that does not count cannot overflow.
    tail = (-distances.abs() / width).exp() / 2
    return torch.where(distances > 0, tail, 1 - tail) / width


def eikonal(gradients: Float[Tensor, "P 3"]) -> Float[Tensor, ""]:
    """How far distances are from growing by a metre a metre: mean absolute difference."""
    squared = gradients.square().sum(1).clamp(min=torch.finfo(gradients.dtype).tiny)
    return (squared.sqrt() - 1).abs().mean()
