"""Truth that no fitter's body model can reach: other surface, other weights, hair, swinging cloth.

Conventions. Rest pose, metres. V vertices of the body, J joints, M instants. The joints stay where
the model's shape numbers put them, so that true poses keep their meaning.
"""

import math
from dataclasses import replace
from typing import Annotated

import numpy as np
import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES, Body
from deblur_avatar.bodies.posed_body import joint_transforms, shaped_joints
from deblur_avatar.config.section import NonNegative, Params
from deblur_avatar.sources.studio.drape import SAG
from deblur_avatar.sources.studio.motion import Moves
from deblur_avatar.sources.studio.person import Person
from deblur_avatar.sources.studio.shells import smooth, vertex_normals

WAVES, LENGTHS = 24, (0.12, 0.4)  # bumps of the surface: how many, from and to, metres
SWING_HZ, DAMPING = 2.2, 0.25  # of hanging cloth: its own rate, its share of critical damping
GRAVITY = 9.81  # m/s^2
MOST = 1.2  # of a swing, in units of gravity's pull
STEP = 1 / 480  # seconds between steps of the pendulum
HEAD = SMPL_JOINT_NAMES.index("head")


class UnfittedParams(Params):
    """How far the truth is from the fitter's model; each 0 is off."""

    shape_mm: NonNegative  # root mean square of bumps along the normals
    weight_rounds: Annotated[int, Field(ge=0)]  # of smoothing that skinning weights go through
    swing: NonNegative  # of loose cloth and hair; 1: as a damped pendulum
    hair_mm: NonNegative  # by which loose hair stands out more


def unfitted_body(body: Body, params: UnfittedParams, generator: torch.Generator) -> Body:
    """A body of another surface and other weights, with the same joints."""
    vertices, faces = body.vertices.double().numpy(), body.faces.numpy()
    directions = torch.randn(WAVES, 3, generator=generator, dtype=torch.float64)
    directions = directions / directions.norm(dim=1, keepdim=True)
    low, high = LENGTHS
    lengths = low + (high - low) * torch.rand(WAVES, generator=generator, dtype=torch.float64)
    phases = 2 * math.pi * torch.rand(WAVES, generator=generator, dtype=torch.float64)
    waves = 2 * math.pi * torch.from_numpy(vertices) @ directions.T / lengths + phases
    bumps = torch.sin(waves).sum(1) * (2 / WAVES) ** 0.5 * params.shape_mm / 1000
    moved = vertices + bumps.numpy()[:, None] * vertex_normals(vertices, faces)
    weights = smooth(body.lbs_weights.double().numpy(), faces, params.weight_rounds)
    weights = weights / weights.sum(1, keepdims=True)
    if params.weight_rounds == 0:
        weights = body.lbs_weights.double().numpy()
    return replace(
        body,
        vertices=torch.from_numpy(moved).float(),
        lbs_weights=torch.from_numpy(weights).float(),
    )


def with_more_hair(person: Person, millimetres: float) -> Person:
    """Loose hair stands out further from the head."""
    drape = person.drape
    loose = drape.sag / SAG * (drape.lbs_weights[:, HEAD] > 0.5)
    out = (millimetres / 1000 * loose)[:, None] * drape.normals
    return replace(person, drape=replace(drape, vertices=(drape.vertices + out).astype(np.float32)))


def swing_of_joints(
    body: Body, betas: Float[Tensor, " B"], moves: Moves, times: Float[Tensor, " M"]
) -> Float[Tensor, "M J 3"]:
    """How far cloth on each joint swings from where it would hang, in units of gravity's pull.

    A damped pendulum that the joint's acceleration drives, from rest at the first time.

    Args:
        body: whose joints.
        betas: its shape numbers.
        moves: at `times`.
        times: seconds, increasing evenly.
    """
    transforms = joint_transforms(
        body, betas.double(), moves.global_orient, moves.body_pose, moves.transl
    )
    rest = shaped_joints(body, betas.double())
    joints = (transforms[..., :3, :3] @ rest[..., None])[..., 0] + transforms[..., :3, 3]
    interval = float(times[1] - times[0])
    pull = torch.zeros_like(joints)
    pull[1:-1] = (joints[2:] - 2 * joints[1:-1] + joints[:-2]) / interval**2 / GRAVITY
    rate, steps = 2 * math.pi * SWING_HZ, max(1, math.ceil(interval / STEP))
    swing, speed = torch.zeros_like(joints[0]), torch.zeros_like(joints[0])
    swings = []
    for driven in pull:
        swings.append(swing.clone())
        for _ in range(steps):
            force = -(rate**2) * (swing + driven) - 2 * DAMPING * rate * speed
            speed = speed + force * interval / steps
            swing = swing + speed * interval / steps
    total = torch.stack(swings)
    return total * (MOST / total.norm(dim=-1, keepdim=True).clamp(min=MOST))
