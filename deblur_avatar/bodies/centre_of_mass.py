"""Centre of mass of a posed body, from its joints.

Segments' masses and centres are those of adults on average: D. A. Winter, Biomechanics and Motor
Control of Human Movement, 4th edition (2009), table 4.1.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES

# Share of the body's mass, share of the way from the first joints' middle to the second's.
TRUNK = (("left_hip", "right_hip"), ("left_shoulder", "right_shoulder"), 0.497, 0.5)
SKULL = (("neck",), ("head",), 0.081, 1.0)
LIMBS = (
    ("hip", "knee", 0.1, 0.433),
    ("knee", "ankle", 0.0465, 0.433),
    ("ankle", "foot", 0.0145, 0.5),
    ("shoulder", "elbow", 0.028, 0.436),
    ("elbow", "wrist", 0.016, 0.43),
    ("wrist", "hand", 0.006, 0.506),
)


def centre_of_mass(joints: Float[Tensor, "F J 3"]) -> Float[Tensor, "F 3"]:
    """Where the mass of a body is on average, metres, within a few centimetres.

    Args:
        joints: SMPL's.
    """
    return torch.einsum("j,fjc->fc", _shares().to(joints), joints)


def _shares() -> Float[Tensor, " J"]:
    """Each joint's share of the mass."""
    shares = torch.zeros(len(SMPL_JOINT_NAMES))
    limbs = (
        ((f"{side}_{near}",), (f"{side}_{far}",), mass, way)
        for side in ("left", "right")
        for near, far, mass, way in LIMBS
    )
    for near, far, mass, way in (TRUNK, SKULL, *limbs):
        for names, share in ((near, 1 - way), (far, way)):
            for name in names:
                shares[SMPL_JOINT_NAMES.index(name)] += mass * share / len(names)
    return shares
