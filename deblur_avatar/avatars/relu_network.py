"""ReLU networks whose output starts next to 0: corrections that grow out of nothing.

Conventions. A condition is the same for all points, so that its share of the first layer is
computed once. P points.
"""

from collections.abc import Sequence
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn

# Not parameters: the published start of all networks of this family.
LAST_WEIGHT = 1e-5  # largest of the last layer
GAIN = 2**0.5  # that a ReLU takes away


class ReluNetwork(nn.Module):
    """ReLU layers over points [P, inputs], with a condition [C] at the first layer.

    Source: HumanNeRF (Weng et al., CVPR 2022), non-rigid motion, and its descendant GoMAvatar.
    """

    def __init__(
        self,
        inputs: int,
        condition: int,
        hidden: Sequence[int],
        outputs: int,
        re_entry: int | None = None,
        generator: torch.Generator | None = None,
    ) -> None:
        """Draw weights after Glorot, but for those of the last layer.

        Args:
            inputs: numbers of a point.
            condition: numbers of the condition.
            hidden: units of each hidden layer.
            outputs: numbers it gives a point.
            re_entry: hidden layer that sees the points' numbers again; the first is 0. None, or
                one that there is not, for no such layer.
            generator: of the weights; None for the process's own.
        """
        super().__init__()
        self._inputs, self._re_entry = inputs, re_entry
        sizes = list(pairwise([inputs + condition, *hidden]))
        if re_entry is not None and re_entry < len(sizes):
            before, after = sizes[re_entry]
            sizes[re_entry] = before + inputs, after
        self.layers = nn.ModuleList(nn.Linear(*size) for size in sizes)
        self.last = nn.Linear(hidden[-1], outputs)
        for layer in self._linear():
            nn.init.xavier_uniform_(layer.weight, GAIN, generator=generator)
            nn.init.zeros_(layer.bias)
        nn.init.uniform_(self.last.weight, -LAST_WEIGHT, LAST_WEIGHT, generator=generator)

    def forward(
        self, points: Float[Tensor, "P I"], condition: Float[Tensor, " C"] | None = None
    ) -> Float[Tensor, "P O"]:
        """Evaluate at every point."""
        first, *others, last = self._linear()
        bias: Tensor = first.bias
        if condition is not None:
            bias = bias + first.weight[:, self._inputs :] @ condition
        value = torch.addmm(bias, points, first.weight[:, : self._inputs].T).relu()
        for index, layer in enumerate(others, start=1):
            if index == self._re_entry:
                value = torch.cat([value, points], dim=1)
            value = layer(value).relu()
        return last(value)

    def _linear(self) -> list[nn.Linear]:
        return [layer for layer in (*self.layers, self.last) if isinstance(layer, nn.Linear)]
