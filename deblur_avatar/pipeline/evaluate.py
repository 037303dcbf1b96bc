"""How good an avatar and its motion are, against a truth that fitting never saw.

Novel views: training instants in the poses refined on the training camera, seen by the other
cameras. Novel poses: the part of the clip kept from training, in true poses where they are known,
else in those that `preprocess` estimated. `recovery` and `gap_to_ceiling_db` compare methods; they
stay null here, so that evaluating one method never waits for another, and `report` fills them in.
"""

import logging
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from deblur_avatar import run
from deblur_avatar.artifacts import Avatar, Motion, Observations, Poses, Reference
from deblur_avatar.avatar.model import AvatarModel, draw
from deblur_avatar.avatar.motion_errors import pose_errors, travel_errors
from deblur_avatar.imaging import metrics
from deblur_avatar.imaging.color import srgb_to_linear
from deblur_avatar.imaging.lpips import lpips_vgg
from deblur_avatar.pipeline.comparison import RECOVERED
from deblur_avatar.pipeline.reblur import reblur
from deblur_avatar.pipeline.truth_views import TruthView, size_of, truth_views

logger = logging.getLogger(__name__)

TIMED_FRAMES = 20


@dataclass(frozen=True, eq=False)
class Comparison:
    """One test view and what the avatar made of it."""

    view: TruthView
    render: UInt8[Tensor, "H W 3"]
    difference: Float[Tensor, "H W"]  # FLIP
    scores: dict[str, float]


@dataclass(frozen=True)
class Evaluation:
    """What was measured, and the comparisons behind it."""

    metrics: dict[str, Any]
    comparisons: list[Comparison]
    render_fps: float  # one picture of the training camera at a time


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
        device: to draw on.

    Raises:
        ArtifactError: if there are test views, but none can be compared.
    """
    model = AvatarModel.from_artifact(avatar, observations.body, device)
    views = truth_views(observations, reference)
    true = _true_poses(observations, reference)
    held_out = observations.poses if true is None else true
    comparisons = [
        compare(
            model, observations, reference, view, held_out if view.novel_pose else motion.centre
        )
        for view in run.progress(views, "test views")
    ]
    novel_views = [comparison for comparison in comparisons if not comparison.view.novel_pose]
    novel_poses = [comparison for comparison in comparisons if comparison.view.novel_pose]
    content = {
        "image": mean_scores(novel_views),
        "novel_pose": mean_scores(novel_poses),
        "cameras": _by_camera(novel_views, observations.cameras.names),
        "motion": _motion(observations, reference, motion, true),
        "initial": _initial(observations, true),
        "reblur": reblur(model, observations, motion),
        "recovery": dict.fromkeys(RECOVERED),
        "gap_to_ceiling_db": None,
        "model": _size(avatar, motion, observations.train),
        "counts": {"novel_views": len(novel_views), "novel_poses": len(novel_poses)},
    }
    fps = _render_fps(model, observations, motion)
    return Evaluation(content, comparisons, fps)


def compare(
    model: AvatarModel,
    observations: Observations,
    reference: Reference,
    view: TruthView,
    poses: Poses,
) -> Comparison:
    """Draw one test view in the pose that `poses` has for it, and score it.

    Colours are drawn with the latent code of the frame if it was trained on, else of the last one
    that was (as 3DGS-Avatar does).
    """
    trained = view.position in observations.train
    width, height = size_of(observations, view.camera)
    image, _ = draw(
        model,
        poses.at([view.position]),
        observations.cameras.Ks[view.camera].to(model.betas.device),
        observations.cameras.viewmats[view.camera].to(model.betas.device),
        width,
        height,
        frame=view.position if trained else max(observations.train),
        background=_background(reference, model),
    )
    render = image.cpu()
    truth = view.image[None].float() / 255
    foreground, seen = view.foreground[None], view.seen[None]
    difference = metrics.flip_map(render, truth)
    scores = {
        "psnr": metrics.psnr(render, truth),
        "ssim": metrics.ssim(render, truth),
        "ssim_range2": metrics.ssim_range2(render, truth),
        "ms_ssim": metrics.ms_ssim(render, truth),
        "flip": difference.double().mean((1, 2)),
        "lpips_vgg": lpips_vgg(render, truth),
        "psnr_foreground": metrics.psnr(render, truth, foreground),
        "psnr_seen": metrics.psnr(render, truth, seen),
        "ssim_seen": metrics.ssim(render, truth, seen),
        "flip_seen": metrics.masked_mean(difference.double(), seen),
        "sharpness_ratio": metrics.sharpness_ratio(render, truth, foreground),
        "sharpness_ratio_seen": metrics.sharpness_ratio(render, truth, seen),
    }
    return Comparison(
        view=view,
        render=(render[0].clamp(0, 1) * 255).round().to(torch.uint8),
        difference=difference[0],
        scores={name: float(value) for name, value in scores.items()},
    )


def _true_poses(observations: Observations, reference: Reference) -> Poses | None:
    """True poses at the middle of each exposure: the nearest samples."""
    if reference.motion is None or reference.motion_times is None:
        return None
    distance = reference.motion_times[None] - observations.timestamps[:, None]
    return reference.motion.at(distance.abs().argmin(1))


def _background(reference: Reference, model: AvatarModel) -> Float[Tensor, " 3"]:
    color = torch.tensor(reference.background)
    light = srgb_to_linear(color) if model.light == "linear" else color
    return light.to(model.betas)


def mean_scores(comparisons: Sequence[Comparison]) -> dict[str, float | None] | None:
    """Mean of each score over pictures, where it was measured."""
    if not comparisons:
        return None
    means: dict[str, float | None] = {}
    for name in comparisons[0].scores:
        values = torch.tensor([comparison.scores[name] for comparison in comparisons])
        measured = values[~values.isnan()]
        means[name] = float(measured.double().mean()) if len(measured) else None
    return means


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
    if observations.exposure:
        errors |= travel_errors(
            observations.body, motion, observations.exposure, frames, reference.motion_times,
            reference.motion,
        )  # fmt: skip
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
    parts = [name for name, part in avatar.model["params"].items() if part is not None]
    return {
        "gaussians": len(avatar.means),
        "parameters": sum(tensor.numel() for tensor in tensors),
        "megabytes": sum(tensor.numel() * tensor.element_size() for tensor in tensors) / 1e6,
        "virtual_poses_mean": float(motion.counts[list(train)].double().mean()),
        "parts": [*parts, f"motion:{motion.kind}"],
    }


def _render_fps(model: AvatarModel, observations: Observations, motion: Motion) -> float:
    """Pictures a second, each in a new pose, dressing included; the first is not counted."""
    camera = observations.train_camera
    width, height = size_of(observations, camera)
    K = observations.cameras.Ks[camera].to(model.betas.device)
    viewmat = observations.cameras.viewmats[camera].to(model.betas.device)
    frames = [observations.train[i % len(observations.train)] for i in range(TIMED_FRAMES + 1)]
    begin = 0.0
    for count, frame in enumerate(frames):
        image, _ = draw(model, motion.centre.at([frame]), K, viewmat, width, height, frame=frame)
        image.cpu()  # waits for a device that runs ahead
        if count == 0:
            begin = time.perf_counter()
    return TIMED_FRAMES / (time.perf_counter() - begin)
