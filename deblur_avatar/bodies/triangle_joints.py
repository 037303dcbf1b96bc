"""Triangle joints: the joint that moves each triangle of a body most."""

from jaxtyping import Int
from torch import Tensor

from deblur_avatar.artifacts.body import Body


def triangle_joints(body: Body) -> Int[Tensor, " T"]:
    """Rows of the joints with the largest of `lbs_weights`, at each triangle's first corner."""
    return body.lbs_weights.argmax(1)[body.faces[:, 0]]
