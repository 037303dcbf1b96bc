"""A pose as one vector that networks can be conditioned on.

Conventions. The root's orientation and translation never enter: a body looks the same to its
clothes wherever it stands. J joints.
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from deblur_avatar.artifacts.body import Body
from deblur_avatar.bodies.posed_body import shaped_joints, shaped_vertices

# Not parameters: networks are saved with these sizes and in this box.
JOINT_FEATURES = 6  # of each joint's code (LEAP, Mihajlovic et al. 2021)
JOINT_PADDING = 0.05  # of the body's extent around it when joints are normalised (3DGS-Avatar)


class PoseEncoder(nn.Module):
    """Encode joint rotations along the kinematic tree.

    Source: 3DGS-Avatar's hierarchical encoder (after LEAP): each joint's small network sees its
    rotation, rest position, bone length and its parent's code. Networks of joints of equal depth
    are evaluated together, and codes are in that order: level by level.
    """

    rest: Tensor
    order: Tensor
    above: Tensor

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
        levels = _levels(body.parents)
        self._sizes = [len(members) for members in levels]
        # Joints level by level, and where in the level above each one's parent stands.
        order = [joint for members in levels for joint in members]
        row = {joint: place for members in levels for place, joint in enumerate(members)}
        places = [row[max(body.parents[joint], 0)] for joint in order]
        self.register_buffer("order", torch.tensor(order), persistent=False)
        self.register_buffer("above", torch.tensor(places), persistent=False)
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
        code = self.overall(everything)[None]
        known = torch.cat([flat, self.rest], dim=1)
        stacks = [known, self.weight1, self.bias1, self.weight2, self.bias2]
        levels = [stack.index_select(0, self.order).split(self._sizes) for stack in stacks]
        codes: list[Tensor] = []
        for seen, weight1, bias1, weight2, bias2, above in zip(
            *levels, self.above.split(self._sizes), strict=True
        ):
            inputs = torch.cat([seen, code.index_select(0, above)], dim=1)[:, None]
            hidden = torch.baddbmm(bias1, inputs, weight1).relu()
            code = torch.baddbmm(bias2, hidden, weight2)[:, 0]
            codes.append(code)
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
