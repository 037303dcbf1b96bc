"""Penalties on an avatar itself, whatever it looks like; 0 when nothing is wrong."""

from jaxtyping import Float
from torch import Tensor


def skinning_distance(
    weights: Float[Tensor, "P J"], body_weights: Float[Tensor, "P J"]
) -> Float[Tensor, ""]:
    """Squared distance of learned blend weights from the body's own, on the body's surface.

    Source: 3DGS-Avatar, L_skin.
    """
    return (weights - body_weights).square().sum(1).mean()
