"""A pose as one vector that networks can be conditioned on.

Conventions. The root's orientation and translation never enter: a body looks the same to its
clothes wherever it stands. J joints.
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from deblur_avatar.artifacts import Body
from deblur_avatar.avatar.body import shaped_joints, shaped_vertices

JOINT_FEATURES = 6  # of each joint's code (LEAP, Mihajlovic et al. 2021)
JOINT_PADDING = 0.05  # of the body's extent around it when joints are normalised (3DGS-Avatar)


class PoseEncoder(nn.Module):
    """Encode joint rotations along the kinematic tree.

    Source: 3DGS-Avatar's hierarchical encoder (after LEAP): each joint's small network sees its
    rotation, rest position, bone length and its parent's code. Networks of joints of equal depth
    are evaluated together, and codes are in that order: level by level.
    """

    rest: Tensor

    def __init__(self, body: Body, betas: Tensor) -> None:
        super().__init__()
        count = len(body.parents)
        self.size = count * JOINT_FEATURES
        joints = shaped_joints(body, betas)
        vertices = shaped_vertices(body, betas)
        centre = vertices.mean(0)
        low, high = (vertices - centre).min(), (vertices - centre).max()
        padding = JOINT_PADDING * (high - low)
        extent = (high - low) * (1 + 2 * JOINT_PADDING)
        normal = (joints - centre - low + padding) / extent * 2 - 1
        above = [max(parent, 0) for parent in body.parents]
        lengths = (joints - joints[above]).norm(dim=-1)
        lengths[0] = joints[0].norm()
        self.register_buffer("rest", torch.cat([normal, lengths[:, None]], -1), persistent=False)
        self._levels = _levels(body.parents)
        self._parents = body.parents
        inputs = 9 + 3 + 1 + JOINT_FEATURES
        self.overall = nn.Linear(count * 12, JOINT_FEATURES)
        self.weight1 = nn.Parameter(_uniform(count, inputs, inputs))
        self.bias1 = nn.Parameter(_uniform(count, 1, inputs, fan_in=inputs))
        self.weight2 = nn.Parameter(_uniform(count, inputs, JOINT_FEATURES))
        self.bias2 = nn.Parameter(_uniform(count, 1, JOINT_FEATURES, fan_in=inputs))

    def forward(self, rotations: Float[Tensor, "J 3 3"]) -> Float[Tensor, " E"]:
        """Encode rotations relative to the parents; the root's must be the identity."""
        flat = rotations.flatten(1)
        everything = torch.cat([flat, self.rest[:, :3]], dim=1).flatten()
        codes: list[Tensor] = []
        row: dict[int, int] = {}
        for level, members in enumerate(self._levels):
            if level == 0:
                above = self.overall(everything)[None]
            else:
                above = codes[-1][[row[self._parents[joint]] for joint in members]]
            inputs = torch.cat([flat[members], self.rest[members], above], dim=1)[:, None]
            hidden = torch.baddbmm(self.bias1[members], inputs, self.weight1[members]).relu()
            codes.append(torch.baddbmm(self.bias2[members], hidden, self.weight2[members])[:, 0])
            row = {joint: index for index, joint in enumerate(members)}
        return torch.cat(codes).flatten()


def _levels(parents: tuple[int, ...]) -> list[list[int]]:
    depth: list[int] = []
    for parent in parents:
        depth.append(0 if parent < 0 else depth[parent] + 1)
    return [[j for j, d in enumerate(depth) if d == level] for level in range(max(depth) + 1)]


def _uniform(*shape: int, fan_in: int | None = None) -> Tensor:
    """PyTorch's default initialisation of a linear layer, for stacks of layers."""
    bound = (shape[-2] if fan_in is None else fan_in) ** -0.5
    return torch.empty(*shape).uniform_(-bound, bound)
