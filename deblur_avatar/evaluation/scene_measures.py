"""Scene statistics before training: blur, coverage, overlap of mask and body."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.body_estimation.landmark_track import sizes
from deblur_avatar.evaluation.body_silhouette import INSIDE, body_triangles
from deblur_avatar.geometry.cameras import camera_centres, project
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.geometry.spacing import evenly_spaced

SAMPLES = 24  # frames whose silhouettes are compared


FULLY_INSIDE = 250  # of 255: no background shows through


SATURATED = 254  # sRGB code from which a channel holds no detail


SEEN_WITHIN = 60.0  # degrees between a surface's normal and the camera in which it is well seen


BIN = 5  # degrees


PARTS = {
    "torso": ("pelvis", "spine3", "neck"),
    "head": ("head",),
    "upper arms": ("left_elbow", "right_elbow"),
    "hands": ("left_hand", "right_hand"),
    "knees": ("left_knee", "right_knee"),
    "feet": ("left_foot", "right_foot"),
}


def blur_extent(observations: Observations) -> dict[str, float]:
    """How far each part of the body travels in the picture while the shutter is open, pixels.

    The 95th percentile over the frames with a person, of the fastest joint of the part; speeds are
    central differences of the estimated poses. Empty where the exposure is not known.
    """
    if not observations.exposure or len(observations.timestamps) < 3:
        return {}
    joints, camera = posed(observations.body, observations.poses).joints, observations.camera
    pixels, _ = project(joints, camera.K, camera.viewmat)
    times = observations.timestamps
    speeds = (pixels[2:] - pixels[:-2]).norm(dim=-1) / (times[2:] - times[:-2])[:, None]
    travel = speeds[observations.weights[1:-1] > 0] * observations.exposure
    names = observations.body.joint_names
    if not len(travel):
        return {}
    return {
        part: float(
            torch.quantile(travel[:, [names.index(joint) for joint in joints_]].amax(1), 0.95)
        )
        for part, joints_ in PARTS.items()
        if all(joint in names for joint in joints_)
    }


def seen_azimuths(observations: Observations) -> Float[np.ndarray, " F"]:
    """Where the camera stood about the body in training frames: degrees, 0 front, 90 left."""
    frames = observations.shown
    poses = observations.poses.at(frames)
    centre = camera_centres(observations.camera.viewmat)
    pelvis = posed(observations.body, poses).joints[:, 0]
    towards = (centre - pelvis)[:, None] @ axis_angle_to_matrix(poses.global_orient)
    return np.degrees(np.arctan2(towards[:, 0, 0].numpy(), towards[:, 0, 2].numpy()))


def coverage(azimuths: Float[np.ndarray, " F"]) -> float:
    """Degrees about the body's vertical whose surface some frame sees within `SEEN_WITHIN`."""
    bins = np.arange(-180, 180, BIN) + BIN / 2
    apart = np.abs((bins[:, None] - azimuths[None] + 180) % 360 - 180)
    return float(BIN * (apart.min(1) <= SEEN_WITHIN).sum()) if len(azimuths) else 0.0


def silhouette(observations: Observations, position: int) -> Bool[np.ndarray, "H W"]:
    """The estimated body in one frame."""
    surface = posed(observations.body, observations.poses.at([position]))
    return body_triangles(surface, observations.camera) >= 0


def spaced_frames(observations: Observations, count: int) -> list[int]:
    """Frames with a person, evenly over the clip."""
    shown = torch.nonzero(observations.weights > 0).flatten().tolist()
    return evenly_spaced(shown, count)


def height_px(observations: Observations, joints: Float[Tensor, "F J 3"]) -> float | None:
    """The person's median height in the training camera, pixels; None without frames.

    Of who lies, her length: the longer side of the box around her joints.
    """
    camera = observations.camera
    places = project(joints, camera.K, camera.viewmat)[0]
    # From the head's joint to the toes' are some nine tenths of a person.
    return float(sizes(places, any_pose=True).median() / 0.9) if len(places) else None


def reprojection_share(
    observations: Observations, fit: Mapping[str, Any], height: float | None
) -> float | None:
    """Reprojection error of the landmarks, as a share of the person's height."""
    name = observations.cameras.names[observations.train_camera]
    found = ((fit.get("fit") or {}).get(name) or {}).get("reprojection_px")
    if found is None or not height:
        return None
    crop, size = (
        values[observations.train_camera]
        for values in (observations.crops, observations.cameras.sizes)
    )
    return float(found * size[1] / crop[3] / height)


def mask_body_iou(observations: Observations) -> float | None:
    """Intersection over union of the estimated body and the mask, mean over frames."""
    scores = []
    for position in spaced_frames(observations, SAMPLES):
        body, mask = (
            silhouette(observations, position),
            observations.mattes[position].numpy() > INSIDE,
        )
        if (body | mask).any():
            scores.append((body & mask).sum() / (body | mask).sum())
    return float(np.mean(scores)) if scores else None


def cut_off_share(observations: Observations, shown: Bool[Tensor, " F"]) -> float:
    """Share of frames whose mask reaches the picture's rim."""
    full = observations.mattes[shown] > INSIDE
    rim = full[:, 0].any(1) | full[:, -1].any(1) | full[:, :, 0].any(1) | full[:, :, -1].any(1)
    return float(rim.float().mean())


def saturated_share(observations: Observations) -> float | None:
    """Share of the person's pixels in which a channel is saturated."""
    inside = observations.mattes > FULLY_INSIDE
    pixels = observations.frames[inside]
    return float((pixels >= SATURATED).any(-1).float().mean()) if len(pixels) else None


def background_light(observations: Observations) -> float | None:
    """Mean light where mattes say that nobody is, of 255: what no avatar of a person explains.

    Where the background is known, what differs from it.
    """
    total, count = 0.0, 0
    for position, frame in enumerate(observations.comparable_frames()):
        outside = observations.mattes[position] == 0
        if not observations.weights[position] > 0 or not outside.any():
            continue
        pixels = frame.float()
        behind = observations.background(position)
        if behind is not None:
            known = behind.float()
            pixels = observations.comparable_part((pixels - known).abs(), position)
        light = pixels[outside]
        total, count = total + float(light.sum(dtype=torch.float64)), count + light.numel()
    return total / count if count else None


def comparable_share(observations: Observations) -> float:
    """Share of the person's coverage whose colours can be compared."""
    if observations.comparable is None:
        return 1.0
    told, count = 0.0, 0.0
    for matte, comparable in zip(observations.mattes, observations.comparable, strict=True):
        told += float((matte.double() * comparable / 255).sum())
        count += float(matte.sum())
    return told / max(count, 1.0)
