"""Latent bones: bones without a joint that a network moves with the pose, for what skin does not.

Conventions. Transforms go from canonical to posed, metres. The canonical pose leaves the root as
it is at rest. A latent bone stands in the root's frame: it turns with the body and travels with
it, and the network sees neither. J joints, B latent bones.

Source: GART (Lei et al., CVPR 2024), sec. 3.3.
"""

from collections.abc import Sequence
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn

from deblur_avatar.geometry.rotations import matrix_to_axis_angle, quat_to_matrix

HEAD_SPREAD = 1e-3  # first weights of the last layer; not a parameter: GART's, bones start still
NUMBERS = 7  # of a bone: a quaternion and a translation


class LatentBones(nn.Module):
    """Transforms of latent bones by the rotations of the body's joints."""

    def __init__(self, joints: int, count: int, hidden: Sequence[int]) -> None:
        super().__init__()
        sizes = [3 * (joints - 1), *hidden]
        layers = [nn.Sequential(nn.Linear(a, b), nn.LeakyReLU()) for a, b in pairwise(sizes)]
        self.layers = nn.Sequential(*layers)
        self.head = nn.Linear(sizes[-1], NUMBERS * count, bias=False)
        nn.init.normal_(self.head.weight, std=HEAD_SPREAD)

    def forward(self, rotations: Float[Tensor, "J 3 3"]) -> Float[Tensor, "B 4 4"]:
        """Rigid transforms in the root's frame.

        Args:
            rotations: of the joints relative to their parents; the root's is not looked at.
        """
        pose = matrix_to_axis_angle(rotations[1:]).flatten()
        numbers = self.head(self.layers(pose)).unflatten(-1, (-1, NUMBERS))
        still = numbers.new_tensor([1.0, 0.0, 0.0, 0.0])
        rows = torch.cat([quat_to_matrix(still + numbers[:, :4]), numbers[:, 4:, None]], dim=2)
        bottom = numbers.new_tensor([0.0, 0.0, 0.0, 1.0]).expand(len(rows), 1, 4)
        return torch.cat([rows, bottom], dim=1)


def with_latent_bones(
    transforms: Float[Tensor, "S J 4 4"],
    latent_bones: Float[Tensor, "B 4 4"],
    root: Float[Tensor, " 3"],
) -> Float[Tensor, "S bones 4 4"]:
    """Transforms of J joints, B latent bones, and the body's translation, as J + B + 1 bones.

    Weights that do not sum to 1 would scale the translation that all joints share. So it is taken
    out of them and put into a last bone, which adds it and nothing else where its weight is 1.

    Args:
        transforms: of the joints at S instants, translation included.
        latent_bones: in the root's frame.
        root: position of the root joint at rest.
    """
    first = transforms[:, 0]
    transl = (first[:, :3, :3] @ root) + first[:, :3, 3] - root
    moved = nn.functional.pad(transl[:, :, None], (3, 0, 0, 1))[:, None]  # turns nothing
    joints = transforms - moved
    # Less its translation the root's transform is a turn about the root joint.
    turned = joints[:, :1] @ latent_bones
    return torch.cat([joints, turned, moved], dim=1)
