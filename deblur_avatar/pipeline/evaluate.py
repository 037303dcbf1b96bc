"""Evaluation of an avatar and its motion against a ground truth that fitting never saw.

Novel views: training instants in the poses refined on the training camera, seen by the other
cameras. Novel poses: the part of the clip kept from training, in true poses where they are known,
else in those that `preprocess` estimated. `recovery` and `gap_to_ceiling_db` compare methods; they
stay null here, so that evaluating one method never waits for another, and `report` fills them in.
"""

import logging
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch

from deblur_avatar import run
from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.avatars.avatar import AvatarModel
from deblur_avatar.avatars.half_precision import as_computed
from deblur_avatar.avatars.kinds import avatar_from_artifact
from deblur_avatar.avatars.render import render_avatar
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.evaluation.body_silhouette import body_triangles
from deblur_avatar.evaluation.color_alignment import color_aligned
from deblur_avatar.evaluation.comparisons import (
    Comparison,
    compare,
    mean_scores,
    pose_of_view,
    true_poses,
)
from deblur_avatar.evaluation.estimated_steps import estimated_steps
from deblur_avatar.evaluation.motion_errors import pose_errors, travel_errors
from deblur_avatar.evaluation.reblur import reblur
from deblur_avatar.evaluation.recovery import nothing_recovered
from deblur_avatar.evaluation.surface_quality import surface_quality
from deblur_avatar.evaluation.truth_views import TruthView, truth_views

logger = logging.getLogger(__name__)

TIMED_FRAMES = 20  # that the rate of rendering is the mean of


@dataclass(frozen=True)
class Evaluation:
    """What was measured, and the comparisons behind it."""

    metrics: dict[str, Any]
    comparisons: list[Comparison]
    render_fps: float  # one picture of the training camera at a time
    computed: dict[str, str]  # networks' precision, and the processor's kind


def evaluate(
    observations: Observations,
    reference: Reference,
    avatar: Avatar,
    motion: Motion,
    device: torch.device,
) -> Evaluation:
    """Measure everything that can be measured of one method on one scene.

    Args:
        observations: the blurred ones, whatever the method was fitted to.
        reference: sharp test views, none for a user's own video, and the true motion where known.
        avatar: fitted.
        motion: of every exposure.
        device: to render on.

    Raises:
        ArtifactError: if there are test views, but none can be compared.
    """
    model = avatar_from_artifact(avatar, observations.body, device)
    views = truth_views(observations, reference)
    true = true_poses(observations, reference)
    held_out = observations.poses if true is None else true
    comparisons = [
        compare(
            model,
            observations,
            reference,
            view,
            held_out.at([view.position])
            if view.novel_pose
            else pose_of_view(observations, motion, view),
        )
        for view in run.progress(views, "test views")
    ]
    novel_views = [comparison for comparison in comparisons if not comparison.view.novel_pose]
    novel_poses = [comparison for comparison in comparisons if comparison.view.novel_pose]
    content: dict[str, Any] = {
        "image": mean_scores(novel_views),
        "novel_pose": mean_scores(novel_poses),
        "cameras": _by_camera(novel_views, observations.cameras.names),
        "motion": _motion(observations, reference, motion, true),
        "initial": _initial(observations, true),
        "reblur": reblur(model, observations, motion),
        "recovery": nothing_recovered(),
        "gap_to_ceiling_db": None,
        "model": _size(avatar, motion, observations.train),
        "surface": surface_quality(model, observations, motion),
        "counts": {"novel_views": len(novel_views), "novel_poses": len(novel_poses)},
    }
    if motion.shutter is not None:
        content["shutter_s"] = motion.shutter
    steps = estimated_steps(observations, reference, motion, true)
    if steps is not None:
        content["steps"] = steps
        content["in_true_poses"] = _in_true_poses(model, observations, reference, true, views)
    if reference.motion is None and novel_views:
        content |= _of_real_cameras(observations, motion, novel_views)
    fps = _render_fps(model, observations, motion)
    return Evaluation(content, comparisons, fps, as_computed(model.precision, device))


def _in_true_poses(
    model: AvatarModel,
    observations: Observations,
    reference: Reference,
    true: Poses | None,
    views: Sequence[TruthView],
) -> dict[str, float | None] | None:
    """What is left of the errors of pictures where the avatar takes the true poses: its own."""
    if true is None:
        return None
    posed_alike = replace(true, betas=model.betas.cpu())
    return mean_scores(
        [
            compare(model, observations, reference, view, posed_alike.at([view.position]))
            for view in run.progress(views, "test views in true poses")
        ]
    )


def _of_real_cameras(
    observations: Observations, motion: Motion, comparisons: Sequence[Comparison]
) -> dict[str, Any]:
    """What only filmed scenes need: colours aligned camera by camera, and how the body lies there.

    A studio's cameras see the same colours, and its body is compared with the true one.
    """
    names = observations.cameras.names
    aligned = color_aligned(comparisons)
    ious: dict[str, list[float]] = {}
    for view in (comparison.view for comparison in comparisons):
        camera = observations.cameras.camera(view.camera)
        pose = pose_of_view(observations, motion, view)
        body = body_triangles(posed(observations.body, pose), camera) >= 0
        person = view.foreground.numpy()
        ious.setdefault(names[view.camera], []).append(
            (body & person).sum() / (body | person).sum()
        )
    return {
        "color_aligned": {"image": mean_scores(aligned), "cameras": _by_camera(aligned, names)},
        "body_iou": {name: float(sum(values) / len(values)) for name, values in ious.items()},
    }


def _by_camera(
    comparisons: Sequence[Comparison], names: Sequence[str]
) -> dict[str, dict[str, float | None] | None]:
    cameras = sorted({comparison.view.camera for comparison in comparisons})
    return {
        names[camera]: mean_scores([c for c in comparisons if c.view.camera == camera])
        for camera in cameras
    }


def _motion(
    observations: Observations, reference: Reference, motion: Motion, true: Poses | None
) -> dict[str, float | None]:
    """Errors over the frames trained on; null where the truth is not known."""
    keys = ("joint_error_mm", "surface_error_mm", "joint_error_deg")
    errors: dict[str, float | None] = dict.fromkeys((*keys, "travel_error_mm"))
    errors["direction_accuracy"] = None
    if true is None or reference.motion is None or reference.motion_times is None:
        return errors
    frames = list(observations.train)
    errors |= pose_errors(observations.body, motion.centre.at(frames), true.at(frames))
    exposure = motion.exposure(observations.exposure)
    if exposure:
        errors |= travel_errors(
            observations.body, motion, exposure, frames, reference.motion_times, reference.motion
        )
    return errors


def _initial(observations: Observations, true: Poses | None) -> dict[str, float | None]:
    """Errors of the poses that fitting started from, over the same frames."""
    if true is None:
        return dict.fromkeys(("joint_error_mm", "surface_error_mm", "joint_error_deg"))
    frames = list(observations.train)
    errors = pose_errors(observations.body, observations.poses.at(frames), true.at(frames))
    return dict(errors)


def _size(avatar: Avatar, motion: Motion, train: Sequence[int]) -> dict[str, Any]:
    """What the avatar is made of; the motion is not counted, since another one can drive it."""
    gaussians = (
        avatar.means, avatar.quats, avatar.log_scales, avatar.opacity_logits, avatar.features,
    )  # fmt: skip
    tensors = [*gaussians, *avatar.networks.values()]
    made_of = avatar.model["params"]
    parts = [name for name, part in made_of.items() if part is not None and name != "kind"]
    parts = [f"avatar:{made_of['kind']}", *parts] if "kind" in made_of else parts
    return {
        "gaussians": len(avatar.means),
        "parameters": sum(tensor.numel() for tensor in tensors),
        "megabytes": sum(tensor.numel() * tensor.element_size() for tensor in tensors) / 1e6,
        "virtual_poses_mean": float(motion.num_samples[list(train)].double().mean()),
        "parts": [*parts, f"motion:{motion.kind}"],
    }


def _render_fps(model: AvatarModel, observations: Observations, motion: Motion) -> float:
    """Pictures a second, each in a new pose, dressing included; the first is not counted."""
    camera = observations.camera
    frames = [observations.train[i % len(observations.train)] for i in range(TIMED_FRAMES + 1)]
    begin = 0.0
    for count, frame in enumerate(frames):
        image, _ = render_avatar(model, motion.centre.at([frame]), camera, frame=frame)
        image.cpu()  # waits for a device that runs ahead
        if count == 0:
            begin = time.perf_counter()
    return TIMED_FRAMES / (time.perf_counter() - begin)
