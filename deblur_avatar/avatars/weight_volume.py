"""Weight volume: blend weights on a grid of voxels round the canonical body.

Conventions. Canonical space, metres. A volume is [C, D, H, W]: channels, then nodes along z, y and
x. Outermost nodes lie on the faces of its box; outside of it the nearest face counts. J joints, B
latent bones. The base weights are non-negative and sum to 1; what is learned on top need not.

Source: GART (Lei et al., CVPR 2024), with the numbers of its release.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from deblur_avatar.geometry.nearest import nearest

# Not parameters: GART's, which no experiment has turned. How fine the grid is, and how much it is
# smoothed, are.
BOX_SCALE = 1.2  # of the body's larger side, in x and y
DEPTH_SHARE = 0.25  # of that, in z: bodies are flat
NEIGHBOURS = 30  # vertices that a node takes its weights from
NEAREST = 1e-4  # metres; nearer vertices count no more
FARTHEST = 1.0  # metres; farther ones count no less
KEPT = 0.7  # of a node's difference from the mean of its neighbours, a round of smoothing
FIRST_LATENT = (
    1e-4  # weight of each latent bone everywhere: without it no bone would get a gradient
)


class WeightVolume(nn.Module):
    """The body's weights on a grid, learned corrections to them, and weights of latent bones."""

    centre: Tensor
    half_size: Tensor
    base: Tensor

    def __init__(
        self,
        vertices: Float[Tensor, "V 3"],
        lbs_weights: Float[Tensor, "V J"],
        nodes: tuple[int, int, int],
        smoothing: int,
        latent_bones: int,
    ) -> None:
        """A volume round a body that has learned nothing yet.

        Args:
            vertices: of the body.
            lbs_weights: theirs.
            nodes: along z, y and x.
            smoothing: rounds of it, over the body's own weights.
            latent_bones: how many.
        """
        super().__init__()
        centre, half = volume_box(vertices)
        base = base_weights(vertices, lbs_weights, node_positions(centre, half, nodes))
        base = smoothed(base, smoothing)
        self.register_buffer("centre", centre, persistent=False)
        self.register_buffer("half_size", half, persistent=False)
        self.register_buffer("base", base / base.sum(0), persistent=False)
        self.corrections = nn.Parameter(torch.zeros_like(base))
        self.latent = nn.Parameter(base.new_full((latent_bones, *nodes), FIRST_LATENT))

    def forward(self, points: Float[Tensor, "N 3"]) -> Float[Tensor, "N W"]:
        """Weights of J joints and B latent bones at points, smooth in the points too."""
        volume = torch.cat([self.base + self.corrections, self.latent])
        return trilinear(volume, (points - self.centre) / self.half_size)


def volume_box(
    vertices: Float[Tensor, "V 3"],
) -> tuple[Float[Tensor, " 3"], Float[Tensor, " 3"]]:
    """Centre and half size of the box of a body's volume."""
    low, high = vertices.amin(0), vertices.amax(0)
    half = BOX_SCALE * (high - low)[:2].max() / 2
    return (low + high) / 2, torch.stack([half, half, DEPTH_SHARE * half])


def node_positions(
    centre: Float[Tensor, " 3"], half: Float[Tensor, " 3"], nodes: Sequence[int]
) -> Float[Tensor, "D H W 3"]:
    """Where the nodes are, `nodes` of them along z, y and x."""
    along = [torch.linspace(-1, 1, n, dtype=half.dtype, device=half.device) for n in nodes]
    z, y, x = torch.meshgrid(*along, indexing="ij")
    return centre + half * torch.stack([x, y, z], dim=-1)


def base_weights(
    vertices: Float[Tensor, "V 3"],
    lbs_weights: Float[Tensor, "V J"],
    nodes: Float[Tensor, "D H W 3"],
) -> Float[Tensor, "J D H W"]:
    """Weights of the vertices nearest to each node, by their nearness; they sum to 1."""
    distance, index = nearest(nodes.flatten(0, -2), vertices, NEIGHBOURS)
    nearness = 1 / distance.to(vertices).clamp(NEAREST, FARTHEST)
    nearness = nearness / nearness.sum(1, keepdim=True)
    near = lbs_weights.to(vertices)[index.to(vertices.device)]
    weights = (nearness[..., None] * near).sum(1)
    return weights.T.unflatten(1, nodes.shape[:3]).contiguous()


def smoothed(volume: Float[Tensor, "C D H W"], rounds: int) -> Float[Tensor, "C D H W"]:
    """Inner nodes drawn towards the mean of their six neighbours, so many times."""
    volume = volume.clone()
    for _ in range(rounds):
        beside = [_beside(volume, axis, start) for axis in (1, 2, 3) for start in (0, 2)]
        mean = torch.stack(beside).mean(0)
        inner = volume[:, 1:-1, 1:-1, 1:-1]
        volume[:, 1:-1, 1:-1, 1:-1] = mean + KEPT * (inner - mean)
    return volume


def _beside(volume: Tensor, axis: int, start: int) -> Tensor:
    """The inner nodes' neighbours on one side of an axis."""
    cut = [slice(None), *[slice(1, -1)] * 3]
    cut[axis] = slice(start, volume.shape[axis] - 2 + start)
    return volume[tuple(cut)]


def trilinear(
    volume: Float[Tensor, "C D H W"], points: Float[Tensor, "N 3"]
) -> Float[Tensor, "N C"]:
    """A volume at points of its box, which is [-1, 1] along x, y and z."""
    found = nn.functional.grid_sample(
        volume[None], points[None, :, None, None, :],
        mode="bilinear", padding_mode="border", align_corners=True,
    )  # fmt: skip
    return found[0, :, :, 0, 0].T


def total_variation(volume: Float[Tensor, "C D H W"]) -> Float[Tensor, ""]:
    """Mean absolute difference of nodes that are next to each other, mean over the axes."""
    return torch.stack([volume.diff(dim=axis).abs().mean() for axis in (1, 2, 3)]).mean()


def magnitude(volume: Float[Tensor, "C D H W"]) -> Float[Tensor, ""]:
    """Mean length of the nodes' channels; nodes that are all zero get no gradient."""
    squared = volume.square().sum(0)
    return squared.clamp(min=torch.finfo(volume.dtype).tiny).sqrt().mean()
