"""How much each joint moves each point of canonical space.

Conventions. Points are in the canonical box, [-1, 1] along each axis. Weights are non-negative, and
each row sums to 1.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from deblur_avatar.artifacts.body import Body
from deblur_avatar.avatars.networks import ConditionedMLP
from deblur_avatar.avatars.params import Precision
from deblur_avatar.geometry.nearest import nearest

NEIGHBOURS = 4  # surface vertices that a point takes its weights from; blended by nearness


class SkinningField(nn.Module):
    """A network from a canonical point to blend weights over the kinematic tree.

    Mass starts at the root; each joint keeps a share and passes the rest to its children, so that
    a point can only belong to a hand through its arm.

    Source: 3DGS-Avatar's skinning network (4 layers of 128) with ARAH's hierarchical softmax.
    """

    terms: Tensor

    def __init__(
        self, parents: tuple[int, ...], hidden: Sequence[int], precision: Precision
    ) -> None:
        super().__init__()
        count = len(parents)
        children = [[j for j, p in enumerate(parents) if p == joint] for joint in range(count)]
        inner = [joint for joint, below in enumerate(children) if below]
        # One logit a child for how a joint's outgoing mass is shared, one a parent for how much.
        edges = sum(len(below) for below in children)
        self.network = ConditionedMLP(3, 0, hidden, edges + len(inner), precision)
        # log w_j = log keep_j + sum over the edges on the path from the root of log pass, and log
        # keep = log pass - gate. A joint with one child passes everything to it: its share is 1.
        forks = [below for below in children if len(below) > 1]
        forked = [child for below in forks for child in below]
        paths = torch.zeros(len(forked), count)
        passed = torch.zeros(len(inner), count)
        kept = torch.zeros(len(inner), count)
        for joint in range(count):
            if joint in inner:
                passed[inner.index(joint), joint] = 1
                kept[inner.index(joint), joint] = -1
            node = joint
            while parents[node] >= 0:
                if node in forked:
                    paths[forked.index(node), joint] = 1
                passed[inner.index(parents[node]), joint] = 1
                node = parents[node]
        # Rows of the logits: each parent's children, and which of these have to share; the gates.
        families = [below for below in children if below]
        self._sizes = [*map(len, families), len(inner)]
        self._forked = [row for row, below in enumerate(families) if len(below) > 1]
        self.register_buffer("terms", torch.cat([paths, passed, kept]), persistent=False)

    def forward(self, points: Float[Tensor, "P 3"]) -> Float[Tensor, "P J"]:
        """Blend weights at each point."""
        return self.from_logits(self.network(points))

    def from_logits(self, logits: Float[Tensor, "P L"]) -> Float[Tensor, "P J"]:
        """Turn the network's outputs into weights that sum to 1."""
        # One row a logit: along short rows a softmax takes five times as long.
        *families, gates = logits.T.contiguous().split(self._sizes)
        shares = [families[row].log_softmax(0) for row in self._forked]
        move = nn.functional.logsigmoid(gates)
        return (torch.cat([*shares, move, gates]).T @ self.terms).exp()


def surface_weights(
    points: Float[Tensor, "P 3"], vertices: Float[Tensor, "V 3"], body: Body
) -> Float[Tensor, "P J"]:
    """Blend weights of points near the body's surface: those of the nearest vertices.

    Args:
        points: canonical positions, metres.
        vertices: the body's vertices in the same pose.
        body: whose weights they are.
    """
    distance, index = nearest(points, vertices, NEIGHBOURS)
    nearness = 1 / (distance.to(points) + 1e-4)
    nearness = nearness / nearness.sum(1, True)
    weights = body.lbs_weights[index.cpu()].to(points)
    return (nearness[..., None] * weights).sum(1)
