"""Statistics of a fitted avatar that need no ground truth: is it one person, and the one filmed?

Conventions. Coverage is the avatar's alpha in [0, 1]. "Outside" is farther from the posed body's
silhouette than `MARGIN`, measured in the picture at the body's depth: clothes and hair may stand
off that far, surroundings stand farther. Shares are of the avatar's whole coverage.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from deblur_avatar.animation.placement import framed_camera
from deblur_avatar.animation.stage import up_of_clip
from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.avatars.avatar import AvatarModel
from deblur_avatar.avatars.render import as_filmed, before, light_behind, render_avatar
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.bodies.triangle_joints import triangle_joints
from deblur_avatar.evaluation.body_silhouette import body_triangles, silhouette_distance
from deblur_avatar.evaluation.reblur import reblurred
from deblur_avatar.geometry.cameras import Camera
from deblur_avatar.geometry.nearest import nearest
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.geometry.spacing import evenly_spaced
from deblur_avatar.imaging.exposure import decode, encode
from deblur_avatar.imaging.overlap import soft_iou

MARGIN = 0.15  # metres that clothes and hair may stand off the body
FRAMES = 12  # of the training camera that are looked at
SIDES = 8  # of the turntable
UPRIGHT = math.radians(15)  # from up: a mean trunk that leans less stands
TURNTABLE_SIZE = 192  # pixels
ROOM = (
    0.35  # around the body on the turntable, as a share of its box: what floats is in the picture
)
CLEAR = 26  # of a matte's 255: from here on a pixel shows some of the person

# Which joints' surface belongs to which part.
PARTS = {
    "left arm": ("left_elbow", "left_wrist", "left_hand"),
    "right arm": ("right_elbow", "right_wrist", "right_hand"),
    "left leg": ("left_knee", "left_ankle", "left_foot"),
    "right leg": ("right_knee", "right_ankle", "right_foot"),
    "head": ("head",),
}


@dataclass(frozen=True, eq=False)
class Look:
    """The avatar and its posed body in one picture."""

    image: Float[Tensor, "H W 3"]  # sRGB
    alpha: Float[Tensor, "H W"]
    distance: Float[np.ndarray, "H W"]  # metres from the body's silhouette, 0 inside

    @property
    def outside(self) -> Float[Tensor, "H W"]:
        """Coverage beyond the margin."""
        return self.alpha * torch.from_numpy(self.distance > MARGIN)


def outside_share(looks: Sequence[Look]) -> float | None:
    """Share of the avatar's coverage that lies outside; None for an avatar that covers nothing."""
    total = sum(float(look.alpha.sum()) for look in looks)
    return sum(float(look.outside.sum()) for look in looks) / total if total else None


def filmed_looks(
    model: AvatarModel, observations: Observations, motion: Motion, positions: Sequence[int]
) -> list[Look]:
    """Averaged renders of some exposures, beside the body in the middle of each."""
    body = observations.body
    looks = []
    for position in positions:
        image, alpha = reblurred(model, observations, motion, position)
        surface = posed(body, motion.centre.at([position]))
        looks.append(Look(image, alpha, silhouette_distance(surface, observations.camera)))
    return looks


def turntable(model: AvatarModel, observations: Observations, motion: Motion) -> list[Look]:
    """The avatar from all sides, each in the pose of another training frame."""
    chosen = evenly_spaced(observations.train, SIDES)
    body = observations.body
    axis = _axis(observations, motion.centre)
    looks = []
    for side in range(SIDES):
        poses = motion.centre.at([chosen[side * len(chosen) // SIDES]])
        camera = _beside(observations, poses, 2 * np.pi * side / SIDES * axis)
        image, alpha = render_avatar(model, poses, camera)
        distance = silhouette_distance(posed(body, poses), camera)
        looks.append(Look(image[0].cpu(), alpha[0].cpu(), distance))
    return looks


def _axis(observations: Observations, fitted: Poses) -> Float[Tensor, " 3"]:
    """What the turntable turns about, a unit vector in the world.

    The person's own mean trunk: who stands leans now and then, but stands on average. Who bends or
    lies does not; in a world that is a camera's, as of all clips that are a file, she is turned
    about the stage's up (docs/decisions/0074).
    """
    joints = posed(observations.body, fitted.at(list(observations.train))).joints
    trunks = joints[:, observations.body.joint_names.index("neck")] - joints[:, 0]
    trunk = torch.nn.functional.normalize(trunks.mean(0), dim=0)
    if not observations.cameras.world_is_a_cameras:
        return trunk
    up = up_of_clip(observations, fitted.betas)
    return trunk if trunk @ up > math.cos(UPRIGHT) else up


def _beside(observations: Observations, poses: Poses, angle: Float[Tensor, " 3"]) -> Camera:
    """The training camera, walked round the person and framed with room to spare."""
    surface = posed(observations.body, poses)
    pelvis = surface.joints[0, 0]
    turn = torch.eye(4)
    turn[:3, :3] = axis_angle_to_matrix(angle)
    turn[:3, 3] = pelvis - turn[:3, :3] @ pelvis
    camera = observations.camera
    return framed_camera(surface.vertices, camera.K, camera.viewmat @ turn, TURNTABLE_SIZE, ROOM)


def far_share(model: AvatarModel) -> float | None:
    """Share of the opacity whose Gaussians stand farther than the margin from the body."""
    gaussians = model.densified
    if gaussians is None or not len(gaussians):
        return None
    means, opacities = gaussians.means.detach().cpu(), gaussians.opacities.detach().cpu()
    distance = nearest(means, model.canonical_vertices.cpu()).distances[:, 0]
    return float(opacities[distance > MARGIN].sum() / opacities.sum())


def explained_share(
    observations: Observations, looks: Sequence[Look], positions: Sequence[int]
) -> float | None:
    """Share of the variance inside the mattes that averaged renders explain.

    1 is a perfect render, 0 is as good as the person's mean colour; below that, worse.
    """
    weights, frames = _person(observations, positions)
    pairs = zip(positions, looks, strict=True)
    renders = [as_filmed(observations, p, look.image, look.alpha) for p, look in pairs]
    return _explained(torch.stack(renders), weights, frames)


def own_explained_share(
    observations: Observations, looks: Sequence[Look], positions: Sequence[int]
) -> float | None:
    """The same with the person's mean colour behind her, in frames and renders.

    An edge a pixel beside the filmed one is then as wrong as it is unlike the rest of her, not as
    it is unlike a bright wall. What is not covered explains nothing.
    """
    weights, frames = _person(observations, positions)
    space = observations.averaging_space
    covered = _mattes(observations, positions)[..., None]
    hers = decode(frames, space)
    lights = [light_behind(observations, position, hers.device) for position in positions]
    behind = [light for light in lights if light is not None]  # of all frames, or of none
    if behind:
        hers = hers - (1 - covered) * torch.stack(behind)
    mean = (weights * hers).sum((0, 1, 2)) / (weights * covered).sum()
    shown = encode((hers + (1 - covered) * mean).clamp(0, 1), space)
    ground = mean.expand(hers.shape[1:])
    renders = [before(ground, look.image, look.alpha, space) for look in looks]
    return _explained(torch.stack(renders), weights, shown)


def _explained(
    renders: Float[Tensor, "S H W 3"],
    weights: Float[Tensor, "S H W 1"],
    frames: Float[Tensor, "S H W 3"],
) -> float | None:
    if not float(weights.sum()):
        return None
    mean = (weights * frames).sum((0, 1, 2)) / weights.sum()
    left = (weights * (renders - frames).square()).sum()
    return float(1 - left / (weights * (frames - mean).square()).sum().clamp(min=1e-9))


def _person(
    observations: Observations, positions: Sequence[int]
) -> tuple[Float[Tensor, "S H W 1"], Float[Tensor, "S H W 3"]]:
    """Some frames, and how much of each pixel is the person's and comparable."""
    index = list(positions)
    weights = _mattes(observations, positions)
    if observations.comparable is not None:
        weights = weights * observations.comparable[index].float() / 255
    return weights[..., None], observations.frames[index].float() / 255


def _mattes(observations: Observations, positions: Sequence[int]) -> Float[Tensor, "S H W"]:
    return observations.mattes[list(positions)].float() / 255


def coverage_iou(
    observations: Observations, looks: Sequence[Look], positions: Sequence[int]
) -> float | None:
    """Soft intersection over union of the avatar's coverage and the mattes."""
    alphas = torch.stack([look.alpha for look in looks])
    return soft_iou(_mattes(observations, positions), alphas)


def parts_inside(
    observations: Observations, motion: Motion, positions: Sequence[int]
) -> dict[str, float]:
    """Share of each part's silhouette that mattes confirm, where the part is in the picture.

    A limb whose fitted motion is wrong lies where the matte shows nobody.
    """
    labels = _part_of_triangles(observations.body)
    met: dict[str, list[float]] = {}
    for position in positions:
        surface = posed(observations.body, motion.centre.at([position]))
        triangles = body_triangles(surface, observations.camera)
        person = observations.mattes[position].numpy() >= CLEAR
        for part, name in enumerate(PARTS):
            shown: Bool[np.ndarray, "H W"] = (triangles >= 0) & (labels[triangles] == part)
            if shown.any():
                met.setdefault(name, []).append(float(person[shown].mean()))
    return {name: float(np.mean(shares)) for name, shares in met.items()}


def _part_of_triangles(body: Body) -> Int[np.ndarray, " T"]:
    """The part each triangle belongs to by its strongest joint, below it too; -1 for the trunk."""
    joints = np.full(len(body.parents), -1)
    for joint, parent in enumerate(body.parents):  # parents come first
        named = [i for i, names in enumerate(PARTS.values()) if body.joint_names[joint] in names]
        inherited = joints[parent] if parent >= 0 else -1
        joints[joint] = named[0] if named else inherited
    return joints[triangle_joints(body).numpy()]
