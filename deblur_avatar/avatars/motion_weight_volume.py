"""Motion-weight volume: how much of each point of the T-pose every joint carries, and how much air.

A network without inputs, whose output is a grid, corrects a prior of one Gaussian a bone. From the
posed body a point is taken back by each joint; how much each has a say is looked up where it gets.

Conventions. T-pose, metres. A volume is [C, N, N, N]: channels, then nodes along z, y and x, whose
outermost lie on the faces of its box; outside of it all is air. J joints, P points.

Source: HumanNeRF, Weng et al., CVPR 2022, with the numbers of its release.
"""

from collections.abc import Sequence
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn

from deblur_avatar.avatars.weight_volume import node_positions
from deblur_avatar.config.section import Count, Params, Positive

# Not parameters: the release's, that no experiment has turned. How fine the grid is, is one.
SLOPE = 0.2  # of leaky ReLUs
KERNEL, STRIDE, PADDING = 4, 2, 1  # of transposed convolutions, each of which doubles the nodes
ACROSS, ALONG = 0.03, 0.06  # metres, of a bone's Gaussian
TRUNK = ("pelvis", "spine1", "spine2", "spine3", "left_collar", "right_collar")
TRUNK_WIDER = 1.5  # times, across the bones of the trunk
HEAD, END = 0.06, 0.02  # metres, of joints without a child: the head, and hands and feet
SMALLEST_SUM = 1e-3  # what priors are divided by where there is hardly any
SMALLEST_PRIOR = 1e-6  # whose logarithm is finite
SMALLEST_SHARE = 1e-4  # of the joints together, by which they divide a point among them


class MotionWeightsParams(Params):
    """The network that makes the volume."""

    margin_m: Positive  # of its box, round the joints
    code: Count  # numbers that it starts from
    dense: Count  # channels of the one node that these become
    channels: tuple[Count, ...]  # after each doubling of the nodes but the last

    @property
    def nodes(self) -> int:
        """N: a node, doubled so many times."""
        return 2 ** (len(self.channels) + 1)


class MotionWeightVolume(nn.Module):
    """Weights of joints on a grid: softmax over all channels of what is learned, plus log prior."""

    low: Tensor
    high: Tensor
    log_prior: Tensor

    def __init__(
        self,
        joints: Float[Tensor, "J 3"],
        parents: tuple[int, ...],
        names: Sequence[str],
        params: MotionWeightsParams,
        generator: torch.Generator | None = None,
    ) -> None:
        """A volume round a skeleton that has learned nothing.

        Args:
            joints: in the T-pose.
            parents: index of each one's parent.
            names: theirs; trunk and head have wider priors.
            params: sizes.
            generator: of the first weights; None for the process's own.
        """
        super().__init__()
        low, high = joints.amin(0) - params.margin_m, joints.amax(0) + params.margin_m
        nodes = node_positions((low + high) / 2, (high - low) / 2, [params.nodes] * 3)
        prior = bone_prior(nodes, joints, parents, names).clamp(min=SMALLEST_PRIOR)
        self.register_buffer("low", low, persistent=False)
        self.register_buffer("high", high, persistent=False)
        self.register_buffer("log_prior", prior.log(), persistent=False)
        self.code = nn.Parameter(torch.randn(params.code, generator=generator))
        self.dense = nn.Linear(params.code, params.dense)
        sizes = pairwise([params.dense, *params.channels, len(joints) + 1])
        self.doublings = nn.ModuleList(
            nn.ConvTranspose3d(*size, KERNEL, STRIDE, PADDING) for size in sizes
        )
        gain = nn.init.calculate_gain("leaky_relu", SLOPE)
        for layer in (self.dense, *self.doublings):
            nn.init.xavier_uniform_(layer.weight, gain, generator=generator)
            nn.init.zeros_(layer.bias)

    def forward(self) -> Float[Tensor, "J N N N"]:
        """Weights of the joints; what they lack to 1 is air's."""
        value = self.dense(self.code)[None, :, None, None, None]
        for doubling in self.doublings:
            value = doubling(nn.functional.leaky_relu(value, SLOPE))
        return (value[0] + self.log_prior).softmax(0)[:-1]

    def weights_at(
        self,
        volume: Float[Tensor, "J N N N"],
        points: Float[Tensor, "P 3"],
        rest_from_posed: Float[Tensor, "J 4 4"],
    ) -> Float[Tensor, "J P"]:
        """Each joint's weight where it takes posed points back to.

        Args:
            volume: what `forward` gave.
            points: in the world.
            rest_from_posed: of each joint.
        """
        # The box is [-1, 1] along each axis; scaling transforms is cheaper than scaling points.
        scale, middle = 2 / (self.high - self.low), (self.high + self.low) / 2
        turns = rest_from_posed[:, :3, :3].mT * scale
        shifts = (rest_from_posed[:, None, :3, 3] - middle) * scale
        places = torch.baddbmm(shifts, points.expand(len(turns), -1, -1), turns)
        found = nn.functional.grid_sample(
            volume[:, None], places[:, None, None],
            mode="bilinear", padding_mode="zeros", align_corners=True,
        )  # fmt: skip
        return found[:, 0, 0, 0]


def taken_back(
    weights: Float[Tensor, "J P"],
    points: Float[Tensor, "P 3"],
    rest_from_posed: Float[Tensor, "J 4 4"],
) -> tuple[Float[Tensor, " P"], Float[Tensor, "P 3"]]:
    """How much of posed points is not air, and where they are in the T-pose: the joints' mean.

    Args:
        weights: of each joint.
        points: in the world.
        rest_from_posed: of each joint.
    """
    share = weights.sum(0)
    blended = (weights.T @ rest_from_posed[:, :3].flatten(1)).unflatten(1, (3, 4))
    places = (blended[..., :3] @ points[..., None])[..., 0] + blended[..., 3]
    return share, places / share.clamp(min=SMALLEST_SHARE)[:, None]


def bone_prior(
    points: Float[Tensor, "*batch 3"],
    joints: Float[Tensor, "J 3"],
    parents: tuple[int, ...],
    names: Sequence[str],
) -> Float[Tensor, " channels *batch"]:
    """A Gaussian round every bone, by the joint that carries it, and last what is left for air."""
    count = len(parents)
    children = [[j for j, parent in enumerate(parents) if parent == k] for k in range(count)]
    carried = []
    for joint, below in enumerate(children):
        ends = [joints[child] for child in below] or [joints[joint]]
        widths = _widths(names[joint], bool(below))
        bones = [_bone(points, joints[joint], end, widths) for end in ends]
        carried.append(torch.stack(bones).sum(0))
    prior = torch.stack(carried)
    air = 1 - prior.sum(0, keepdim=True).clamp(0, 1)
    prior = torch.cat([prior, air])
    return prior / prior.sum(0).clamp(min=SMALLEST_SUM)


def _widths(name: str, is_bone: bool) -> tuple[float, float]:
    """Standard deviations across and along what a joint carries."""
    if not is_bone:
        return (HEAD, HEAD) if name == "head" else (END, END)
    return (TRUNK_WIDER * ACROSS if name in TRUNK else ACROSS), ALONG


def _bone(
    points: Tensor, start: Tensor, end: Tensor, widths: tuple[float, float]
) -> Float[Tensor, "*batch"]:
    """exp(-(across / 2 a)^2 - (along / 2 b)^2) from the bone's middle; the release's exponent."""
    apart = points - (start + end) / 2
    along = apart @ nn.functional.normalize(end - start, dim=0)
    across = apart.square().sum(-1) - along.square()
    return (-across / (2 * widths[0]) ** 2 - along.square() / (2 * widths[1]) ** 2).exp()
