"""Registration of estimated to true poses, so that test cameras see an avatar of one's own video.

The world of such a clip is estimated: its scale hangs on the body's height, depth on the focal
length. So the true joints of an instant are compared with the estimated ones up to a similarity,
p_true = scale * turn @ p_estimated + shift, and a test camera that stands relative to the true
person is brought to the estimated one by it, which changes no picture of the true person.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import posed


class Similarity(NamedTuple):
    """From estimated to true places."""

    scale: float
    turn: Float[Tensor, "3 3"]
    shift: Float[Tensor, " 3"]  # metres

    def applied(self, points: Float[Tensor, "P 3"]) -> Float[Tensor, "P 3"]:
        """Places in the true world."""
        return self.scale * points @ self.turn.T + self.shift


def similarity(estimated: Float[Tensor, "P 3"], true: Float[Tensor, "P 3"]) -> Similarity:
    """The similarity of least squared distances.

    Source: Umeyama, "Least-squares estimation of transformation parameters", PAMI 1991, eq. 39-43.
    """
    from_middle = estimated - estimated.mean(0)
    to_middle = true - true.mean(0)
    U, sizes, Vh = torch.linalg.svd(to_middle.T @ from_middle)
    signs = torch.ones_like(sizes)
    signs[-1] = torch.sign(torch.linalg.det(U) * torch.linalg.det(Vh))
    turn = U @ torch.diag(signs) @ Vh
    scale = float((sizes * signs).sum() / from_middle.square().sum())
    return Similarity(scale, turn, true.mean(0) - scale * turn @ estimated.mean(0))


def registered(
    viewmat: Float[Tensor, "4 4"], body: Body, estimated: Poses, true: Poses
) -> Float[Tensor, "4 4"]:
    """Where a camera stands relative to estimated poses that stood so relative to the true ones.

    Args:
        viewmat: true world to camera.
        body: whose joints are compared.
        estimated: one pose.
        true: of the same instant.
    """
    pair = [posed(body, poses).joints[0].double() for poses in (estimated, true)]
    return seen_through(viewmat, similarity(*pair))


def seen_through(viewmat: Float[Tensor, "4 4"], moved: Similarity) -> Float[Tensor, "4 4"]:
    """A camera of the true world, in the estimated one: it takes the same picture."""
    there = viewmat.double()
    placed = torch.eye(4, dtype=torch.float64)
    placed[:3, :3] = there[:3, :3] @ moved.turn
    # A picture does not change when the camera's coordinates are all divided by the scale.
    placed[:3, 3] = (there[:3, :3] @ moved.shift + there[:3, 3]) / moved.scale
    return placed.to(viewmat)
