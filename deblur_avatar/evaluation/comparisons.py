"""Scores of a test view: the avatar's render against the ground truth."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.avatars.avatar import AvatarModel
from deblur_avatar.avatars.render import render_avatar
from deblur_avatar.evaluation.instants import pose_at
from deblur_avatar.evaluation.metrics import ImagePair, scores
from deblur_avatar.evaluation.registration import registered
from deblur_avatar.evaluation.truth_views import TruthView
from deblur_avatar.geometry.cameras import Camera
from deblur_avatar.imaging.exposure import decode


@dataclass(frozen=True, eq=False)
class Comparison:
    """One test view and what the avatar made of it."""

    view: TruthView
    render: UInt8[Tensor, "H W 3"]
    alpha: Float[Tensor, "H W"]  # the avatar's coverage
    difference: Float[Tensor, "H W"]  # FLIP
    scores: dict[str, float]


def compare(
    model: AvatarModel,
    observations: Observations,
    reference: Reference,
    view: TruthView,
    pose: Poses,
) -> Comparison:
    """Render one test view in its pose, and score it.

    Colours take the latent code of the frame if it was trained on, else of the last one
    that was (as 3DGS-Avatar does).
    """
    trained = view.position in observations.train
    image, alpha = render_avatar(
        model,
        pose,
        _camera_of(observations, reference, view, pose),
        frame=view.position if trained else max(observations.train),
        background=_background(reference, model),
    )
    pair = ImagePair(
        render=image.cpu(),
        truth=view.image[None].float() / 255,
        foreground=view.foreground[None],
        seen=view.seen[None],
    )
    return Comparison(
        view=view,
        render=(pair.render[0].clamp(0, 1) * 255).round().to(torch.uint8),
        alpha=alpha[0].cpu(),
        difference=pair.flip_map[0],
        scores={name: float(values) for name, values in scores(pair).items()},
    )


def compare_views(
    model: AvatarModel,
    observations: Observations,
    reference: Reference,
    motion: Motion,
    views: Iterable[TruthView],
) -> list[Comparison]:
    """Compare test views in the poses that a fitted motion has for them."""
    return [
        compare(model, observations, reference, view, pose_of_view(observations, motion, view))
        for view in views
    ]


def pose_of_view(observations: Observations, motion: Motion, view: TruthView) -> Poses:
    """The pose that a fitted motion has for the instant that a test view shows."""
    body, exposure = observations.body, observations.exposure
    return pose_at(body, motion, exposure, view.position, view.offset)


def _camera_of(
    observations: Observations, reference: Reference, view: TruthView, pose: Poses
) -> Camera:
    """The view's camera; where the world was estimated, brought to the pose that is seen."""
    camera = observations.cameras.camera(view.camera)
    true = None if view.viewmat is None else true_poses(observations, reference)
    if view.viewmat is None or true is None:
        return camera
    here = true.at([view.position])
    return replace(camera, viewmat=registered(view.viewmat, observations.body, pose, here))


def true_poses(observations: Observations, reference: Reference) -> Poses | None:
    """True poses at the middle of each exposure: the nearest samples."""
    if reference.motion is None or reference.motion_times is None:
        return None
    distance = reference.motion_times[None] - observations.timestamps[:, None]
    return reference.motion.at(distance.abs().argmin(1))


def _background(reference: Reference, model: AvatarModel) -> Float[Tensor, " 3"]:
    color = torch.tensor(reference.background)
    light = decode(color, model.averaging_space)
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
