"""Torn parts: head and limbs of a fitted avatar through which one sees, without ground truth."""

from collections.abc import Mapping

import torch

from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.avatars.avatar import AvatarModel
from deblur_avatar.avatars.closure import closure_views
from deblur_avatar.bodies.triangle_joints import triangle_joints
from deblur_avatar.geometry.rotations import axis_angle_to_matrix

# Joints whose surface must not be seen through; hands and feet are thin and often hidden.
CLOSED_PARTS = (
    "head", "left_shoulder", "right_shoulder", "left_elbow", "right_elbow",
    "left_hip", "right_hip", "left_knee", "right_knee",
)  # fmt: skip
CLOSED = 0.5  # alpha from where on a pixel is not seen through


def parts_open(model: AvatarModel, motion: Motion, position: int) -> dict[str, float]:
    """Share of each part, well inside its silhouette, through which one sees, from all sides.

    Parts that the kind of avatar closes nearer to their silhouette are looked at so, too; the
    larger share counts.

    Args:
        model: stands in the canonical pose, where its parts are apart.
        motion: of every exposure.
        position: of the exposure for whose pose the avatar is conditioned.
    """
    shares = _parts_open(model, motion, position, {})
    if model.closed_nearer:
        nearer = _parts_open(model, motion, position, model.closed_nearer)
        shares = {name: max(share, nearer[name]) for name, share in shares.items()}
    return shares


def _parts_open(
    model: AvatarModel, motion: Motion, position: int, nearer: Mapping[str, float]
) -> dict[str, float]:
    body = model.body
    strongest = triangle_joints(body)
    poses = motion.centre.at([position])
    rotations = axis_angle_to_matrix(poses.axis_angle)[0].to(model.betas.device)
    count = torch.zeros(2, len(body.parents))  # pixels, and those seen through
    with torch.no_grad():
        for view in closure_views(model.canonical_vertices, body, nearer):
            alpha = view.coverage(model, rotations, position).cpu()
            joints = strongest[view.triangles[view.inside].cpu()]
            count[0] += torch.bincount(joints, minlength=len(body.parents))
            count[1] += torch.bincount(joints[alpha < CLOSED], minlength=len(body.parents))
    rows = [body.joint_names.index(name) for name in CLOSED_PARTS]
    found = zip(CLOSED_PARTS, count[:, rows].T.tolist(), strict=True)
    return {name: opened / pixels for name, (pixels, opened) in found if pixels}
