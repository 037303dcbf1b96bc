"""Measures of one fit of the suite: the evaluation's numbers and a few of its own.

Conventions. The score is PSNR over the surface that the training camera saw, novel views, dB. Crops
are discs around joints of the true pose; silhouettes are where coverage exceeds one half.
"""

import dataclasses
import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from benchmarks.stress.exposures import blend_measures, shared_condition_db
from benchmarks.stress.fit import Fitted
from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.avatars.avatar import AvatarModel
from deblur_avatar.avatars.kinds import avatar_from_artifact
from deblur_avatar.avatars.render import render_avatar
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.evaluation.comparisons import Comparison, pose_of_view
from deblur_avatar.evaluation.recovery import averaged
from deblur_avatar.evaluation.truth_views import truth_views
from deblur_avatar.geometry.cameras import project
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.imaging import metrics
from deblur_avatar.imaging.color import srgb_to_linear
from deblur_avatar.pipeline.evaluate import evaluate

LIMBS = ("elbow", "wrist", "hand", "knee", "ankle", "foot")
TORSO = ("pelvis", "spine1", "spine2", "spine3", "neck")
RADIUS = 0.1  # metres around a joint
CLOCKS = ("seconds", "processor_s")  # what no two measurements agree in
HALF = 0.5  # of full coverage

Picture = UInt8[np.ndarray, "_ _ 3"]


@dataclass(frozen=True)
class Measured:
    """Numbers, and the test view that came out worst: blurred frame, render, truth."""

    numbers: dict[str, Any]
    pictures: tuple[Picture, Picture, Picture]


def measure(
    observations: Observations, reference: Reference, fitted: Fitted, device: torch.device
) -> Measured:
    """Compare a fit with the truth.

    Args:
        observations: the blurred ones, damaged as fitting saw them.
        reference: the truth, undamaged.
        fitted: avatar and motion.
        device: to draw on.
    """
    avatar, motion = fitted.avatar, fitted.motion
    evaluation = evaluate(observations, reference, avatar, motion, device)
    shown = [c for c in evaluation.comparisons if not c.view.novel_pose]
    content = evaluation.metrics
    novel = content["novel_pose"] or {}
    crops = _crop_scores(observations, reference, shown)
    numbers = {
        "score": content["image"]["psnr_seen"],
        "psnr": content["image"]["psnr"],
        "sharpness": content["image"]["sharpness_ratio_seen"],
        "psnr_novel_pose": novel.get("psnr"),
        "score_novel_pose": novel.get("psnr_seen"),
        **crops,
        "area_error": _area_error(observations, shown, fitted, device),
        **content["motion"],
        "initial_joint_error_mm": content["initial"]["joint_error_mm"],
        "reblur_psnr": content["reblur"]["psnr_train"],
        "virtual_poses": content["model"]["virtual_poses_mean"],
        "gaussians": content["model"]["gaussians"],
        "mean_scale_mm": 1e3 * float(avatar.log_scales.exp().mean()),
        "stretch": _stretch(observations, reference, avatar, device),
        "knots": len(motion.parameters["axis_angle"]) if motion.kind == "clip" else None,
        "shutter_s": fitted.shutter,
        "shutter_std_s": fitted.shutter_std,
        "given_exposure_s": observations.exposure,
        "hidden": observations.occluded_fraction,
        "finite": math.isfinite(content["image"]["psnr"]),
        **blend_measures(observations, reference, fitted, device),
        "shared_condition_db": shared_condition_db(observations, fitted, device),
        "seconds": fitted.seconds,
        "processor_s": fitted.processor_s,
        "digest": _digest(avatar),
    }
    return Measured(numbers, _worst(observations, shown))


def score_of(
    observations: Observations, reference: Reference, fitted: Fitted, device: torch.device
) -> dict[str, float]:
    """The score alone, as `measure` has it: all that a bound is asked for."""
    model = avatar_from_artifact(fitted.avatar, observations.body, device)
    background = torch.tensor(reference.background)
    if model.averaging_space == "linear":
        background = srgb_to_linear(background)
    scores = []
    for view in truth_views(observations, reference):
        if view.novel_pose or not view.seen.any():
            continue
        image, _ = render_avatar(
            model,
            pose_of_view(observations, fitted.motion, view),
            observations.cameras.camera(view.camera),
            frame=view.position,
            background=background.to(model.betas),
        )
        truth = view.image[None].float() / 255
        scores.append(float(metrics.psnr(image.cpu(), truth, view.seen[None])))
    return {"score": sum(scores) / len(scores)}


def mean_of_draws(draws: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The means of what several draws of one fit measured; what is no number is the first's.

    `scores` keeps every draw's score; a number that one draw could not measure is None. Times are
    the shortest: what else a machine does makes them longer, never shorter.
    """
    row = dict(draws[0])
    if len(draws) > 1:
        truths = {key for key, value in row.items() if isinstance(value, bool)}
        row |= averaged(map(dict, draws), complete=True)
        row |= {key: all(draw[key] for draw in draws) for key in truths}
        row |= {key: min(draw[key] for draw in draws) for key in CLOCKS if key in row}
    return row | {"scores": [draw["score"] for draw in draws]}


def _crop_scores(
    observations: Observations, reference: Reference, shown: Sequence[Comparison]
) -> dict[str, float | None]:
    """PSNR around the joints of the limbs and of the torso, means over views."""
    assert reference.motion is not None
    assert reference.motion_times is not None
    scores: dict[str, list[float]] = {"limbs": [], "torso": []}
    for comparison in shown:
        view = comparison.view
        time = observations.timestamps[view.position]
        nearest = int((reference.motion_times - time).abs().argmin())
        joints = posed(observations.body, reference.motion.at([nearest])).joints[0]
        for name, ends in (("limbs", LIMBS), ("torso", TORSO)):
            chosen = [i for i, joint in enumerate(SMPL_JOINT_NAMES) if joint.endswith(ends)]
            mask = _discs(observations, view.camera, joints[chosen]) & view.seen
            if mask.any():
                render, truth = comparison.render[None] / 255, view.image[None] / 255
                scores[name].append(float(metrics.psnr(render, truth, mask[None])))
    return {f"psnr_{n}": sum(s) / len(s) if s else None for n, s in scores.items()}


def _discs(
    observations: Observations, camera: int, joints: Float[Tensor, "J 3"]
) -> Bool[Tensor, "H W"]:
    view = observations.cameras.camera(camera)
    pixels, depths = project(joints, view.K, view.viewmat)
    rows, columns = torch.arange(view.height) + 0.5, torch.arange(view.width) + 0.5
    across = columns[None, None, :] - pixels[:, 0, None, None]
    down = rows[None, :, None] - pixels[:, 1, None, None]
    radius = RADIUS * view.K[0, 0] / depths
    return (across.square() + down.square() < radius.square()[:, None, None]).any(0)


def _area_error(
    observations: Observations,
    shown: Sequence[Comparison],
    fitted: Fitted,
    device: torch.device,
) -> float:
    """By which share rendered silhouettes are larger than true ones, over all test views."""
    model = avatar_from_artifact(fitted.avatar, observations.body, device)
    rendered, true = 0.0, 0.0
    for comparison in shown:
        view = comparison.view
        _, alpha = render_avatar(
            model,
            fitted.motion.centre.at([view.position]),
            observations.cameras.camera(view.camera),
        )
        rendered += float((alpha > HALF).sum())
        true += float(view.foreground.sum())
    return rendered / max(true, 1.0) - 1


def _stretch(
    observations: Observations, reference: Reference, avatar: Avatar, device: torch.device
) -> float | None:
    """The most that a Gaussian grows from training poses to those kept from training.

    Its longest axis in the worst held-out pose over its longest in any training pose.
    """
    held_out = sorted(set(reference.frame_indices[reference.novel_pose == 1].tolist()))
    times = [
        observations.timestamps[observations.frame_indices.index(frame)]
        for frame in held_out
        if frame in observations.frame_indices
    ]
    if not times or reference.motion is None or reference.motion_times is None:
        return None
    nearest = [int((reference.motion_times - time).abs().argmin()) for time in times]
    model = avatar_from_artifact(avatar, observations.body, device)
    trained = _longest(model, observations.poses.at(list(observations.train)))
    posed = _longest(model, reference.motion.at(nearest))
    return float((posed / trained.clamp(min=1e-9)).max())


def _longest(model: AvatarModel, poses: Poses) -> Float[Tensor, " N"]:
    """Each Gaussian's longest axis over some poses, metres."""
    rotations = axis_angle_to_matrix(poses.axis_angle).to(model.betas)
    view = torch.eye(4).to(model.betas)  # no length depends on it
    with torch.no_grad():
        transforms = model.transforms(rotations, poses.transl.to(model.betas))
        lengths = []
        for index in range(len(rotations)):
            state = model.condition(rotations[index], 0, transforms[index], view)
            _, covars = state.posed(transforms[index : index + 1])
            xx, xy, xz, yy, yz, zz = covars[0].unbind(-1)
            rows = (xx, xy, xz, xy, yy, yz, xz, yz, zz)
            full = torch.stack(rows, -1).unflatten(-1, (3, 3))
            lengths.append(torch.linalg.eigvalsh(full)[:, -1].clamp(min=0).sqrt())
    return torch.stack(lengths).amax(0)


def _worst(
    observations: Observations, shown: Sequence[Comparison]
) -> tuple[Picture, Picture, Picture]:
    """Of the views that show mostly what the training camera saw, the one rendered worst."""
    views = [c for c in shown if 2 * c.view.seen.sum() >= c.view.foreground.sum() > 0] or shown
    worst = min(views, key=lambda comparison: comparison.scores["psnr_foreground"])
    blurred = observations.frames[worst.view.position]
    return blurred.numpy(), worst.render.numpy(), worst.view.image.numpy()


def _digest(avatar: Avatar) -> str:
    """Equal for equal avatars, bit by bit."""
    fields = [field.name for field in dataclasses.fields(avatar)]
    tensors = [v for name in fields if isinstance(v := getattr(avatar, name), Tensor)]
    tensors += [avatar.networks[name] for name in sorted(avatar.networks)]
    content = b"".join(tensor.contiguous().numpy().tobytes() for tensor in tensors)
    return hashlib.sha256(content).hexdigest()[:16]
