"""Errors of every step that was estimated: mattes, focal length, poses, each against its truth.

Conventions. Millimetres are of the true world. Poses of one's own video are in its camera's axes;
`registered` errors are what is left after the best similarity of each frame, `rooted` ones after
the pelvis was put in place.
"""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.artifacts.reference import FilmedTruth, Reference
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.evaluation.body_silhouette import INSIDE
from deblur_avatar.evaluation.registration import similarity
from deblur_avatar.evaluation.truth_views import cut_as_observed


def estimated_steps(
    observations: Observations, reference: Reference, motion: Motion, true: Poses | None
) -> dict[str, Any] | None:
    """What each step got wrong; None for footage that does not know."""
    if reference.filmed is None or true is None:
        return None
    frames = list(observations.train)
    body = observations.body
    joints = posed(body, true.at(frames)).joints
    camera = observations.train_camera
    scale = float(observations.cameras.sizes[camera, 0]) / float(observations.crops[camera, 2])
    focal = float(observations.cameras.Ks[camera, 0, 0]) / scale
    return {
        "mattes": matte_errors(observations, reference.filmed),
        "focal": {"estimated_px": focal, "true_px": reference.filmed.focal},
        "poses": {
            "initial": joint_errors(posed(body, observations.poses.at(frames)).joints, joints),
            "fitted": joint_errors(posed(body, motion.centre.at(frames)).joints, joints),
        },
    }


def matte_errors(observations: Observations, filmed: FilmedTruth) -> dict[str, float]:
    """Overlap of the halves, and mean absolute difference, of training frames' mattes."""
    both = either = away = 0.0
    for position in observations.train:
        frame = observations.frame_indices[position]
        true = cut_as_observed(observations, observations.train_camera, filmed.mattes[frame])
        found = observations.mattes[position]
        both += float(((found > INSIDE) & (true > INSIDE)).sum())
        either += float(((found > INSIDE) | (true > INSIDE)).sum())
        away += float((found.float() - true.float()).abs().mean()) / 255
    return {"iou": both / max(either, 1.0), "mae": away / len(observations.train)}


def joint_errors(found: Float[Tensor, "F J 3"], true: Float[Tensor, "F J 3"]) -> dict[str, float]:
    """Mean distances of joints, and how far off the person's depth and size are.

    Returns:
        `joint_error_mm` in the camera's axes; `rooted_mm` and `registered_mm`; `depth_ratio`,
        estimated to true distance of the pelvis, the median; `scale`, by which the estimated
        person must be multiplied, the median.
    """
    errors = [similarity(f.double(), t.double()) for f, t in zip(found, true, strict=True)]
    left = [
        (moved.applied(f.double()) - t.double()).norm(dim=-1).mean()
        for moved, f, t in zip(errors, found, true, strict=True)
    ]
    rooted = (found - found[:, :1]) - (true - true[:, :1])
    return {
        "joint_error_mm": 1e3 * float((found - true).norm(dim=-1).mean()),
        "rooted_mm": 1e3 * float(rooted.norm(dim=-1).mean()),
        "registered_mm": 1e3 * float(torch.stack(left).mean()),
        "depth_ratio": float((found[:, 0, 2] / true[:, 0, 2]).median()),
        "scale": float(torch.tensor([moved.scale for moved in errors]).median()),
    }
