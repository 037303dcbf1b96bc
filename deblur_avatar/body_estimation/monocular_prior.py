"""The monocular prior: a detector's rough shape in space, and feet that stand still.

One camera does not see depth. A detector's guess about the hips stands in for it, held loosely
throughout the fit, and feet that do not move in the picture do not move in space either, which
keeps a standing person from swaying towards the camera and back. F frames, L landmarks in use.
"""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.bodies.posed_body import joint_transforms, shaped_joints
from deblur_avatar.body_estimation.body_landmarks import LandmarkMap
from deblur_avatar.body_estimation.landmark_track import (
    CleanTrack,
    clean,
    trust,
)
from deblur_avatar.body_estimation.landmarks import Landmarks
from deblur_avatar.body_estimation.lifting import lift
from deblur_avatar.body_estimation.pace import Pace
from deblur_avatar.body_estimation.robust_costs import growing, saturating
from deblur_avatar.body_estimation.triangulation import Triangulated

GUESS_M = 0.12  # standard deviation of a detector's guess of depth
HIDDEN = 0.3  # how far the guess is believed of a landmark that is not seen (decision 85)
STANDING_SPEED = 0.12  # heights a second in the picture; slower, and a foot stands
STANDS_M_S = 0.1  # standard deviation of the speed of a foot that stands
FEET = (29, 30, 31, 32)  # MediaPipe's heels and toes
HIPS = (23, 24)  # MediaPipe's
_LIMBS = (
    (11, 13), (13, 15), (12, 14), (14, 16), (23, 25), (25, 27), (24, 26), (26, 28), (11, 23),
    (12, 24),
)  # fmt: skip


class OneView(NamedTuple):
    """What is known beside the pictures, in the world's axes, metres."""

    found: Triangulated  # lifted landmarks
    about_hips: Float[Tensor, "F L 3"]
    sure: Float[Tensor, "F L"]  # how far the guess is believed
    stands: Bool[Tensor, "G L"]  # from each frame to the next
    trust: Float[Tensor, " F"]  # share of landmarks that nothing was wrong with
    flags: dict[str, int]


def apply_monocular_prior(
    body: Body,
    marks: LandmarkMap,
    person: Landmarks,
    cameras: Cameras,
    camera: int,
    basis: Float[Tensor, "F D"],
    extent: float,
    pace: Pace,
    *,
    any_pose: bool,
) -> tuple[Landmarks, OneView]:
    """Clear a person's landmarks of mistakes and lift them into space.

    In any pose, the guess of what is not seen is believed as well, and `lift` keeps only its depth.

    Returns:
        The person with mistakes put right or at no confidence, and what else is known.
    """
    known = [row for row in marks.rows if person.visibility[:, row].any()]  # to its detector
    track: CleanTrack = clean(person, pace, extent, any_pose=any_pose)
    person, rows = track.person, list(marks.rows)
    K, viewmat = cameras.Ks[camera], cameras.viewmats[camera]
    guess, believed = _guess(body, marks, person)
    confidences = person.visibility[:, rows]
    found = lift(
        person.points[:, rows], confidences, guess, K, viewmat, basis, extent, pace,
        any_pose=any_pose,
    )  # fmt: skip
    one = OneView(
        found=found,
        about_hips=guess @ viewmat[:3, :3],  # from the camera's axes to the world's
        sure=(_sure(confidences) if any_pose else confidences) * believed[:, None],
        stands=_standing(person.points[:, rows], confidences, marks, extent, pace),
        trust=trust(track.flags, known or marks.rows) * person.found,
        flags=track.flags.counts(),
    )
    return person, one


def guess_cost(
    known: OneView, marks: LandmarkMap, landmarks: Float[Tensor, "F L 3"]
) -> Float[Tensor, ""]:
    """Distance from the detector's guess, growing ever slower; wrong guesses are common."""
    hips = [marks.rows.index(mark) for mark in HIPS]
    about = landmarks - landmarks[:, hips].mean(1, keepdim=True)
    squared = (about - known.about_hips).square().sum(-1) / GUESS_M**2
    return (known.sure * growing(squared)).sum()


def standing_cost(
    known: OneView, landmarks: Float[Tensor, "F L 3"], pace: Pace
) -> Float[Tensor, ""]:
    """Squared speed in space of feet that stand in the picture."""
    way = (landmarks[1:] - landmarks[:-1]).norm(dim=-1)
    speed = way / (pace.steps.to(way.dtype)[:, None] * (pace.interval * STANDS_M_S))
    return (known.stands * saturating(speed.square())).sum()


def _sure(confidences: Float[Tensor, "F L"]) -> Float[Tensor, "F L"]:
    """Believe the guess of what is hidden a little; of what was found wrong nothing.

    An arm behind the trunk is in no picture. Without its guess it lies wherever the matte hides it,
    stretched away from the camera as well as bent.
    """
    return torch.where(confidences > 0, confidences.clamp(min=HIDDEN), confidences)


def _guess(
    body: Body, marks: LandmarkMap, person: Landmarks
) -> tuple[Float[Tensor, "F L 3"], Float[Tensor, " F"]]:
    """Landmarks about the hips in the camera's axes, as tall as the body, and where to believe it.

    Without a detector's guess the person stands upright and faces the camera, or away from it if
    her left shoulder is on the left.
    """
    still = torch.zeros(1, 3)
    rest_joints = shaped_joints(body, torch.zeros(body.shape_dirs.shape[2]))
    upright = joint_transforms(
        body,
        torch.zeros(body.shape_dirs.shape[2]),
        still,
        torch.zeros(1, len(body.parents) - 1, 3),
        still,
    )
    rest = marks.positions(upright, rest_joints, marks.offsets)[0]
    hips = [marks.rows.index(mark) for mark in HIPS]
    rest = rest - rest[hips].mean(0)
    left, right = person.points[:, 11, 0], person.points[:, 12, 0]
    facing = torch.where(left >= right, 1.0, -1.0)
    axes = torch.stack([facing, -torch.ones_like(facing), -facing], dim=-1)
    guess = rest * axes[:, None]
    if person.world is None:
        return guess, torch.zeros(len(guess))
    rows = list(marks.rows)
    world = person.world[:, rows]
    world = world - world[:, hips].mean(1, keepdim=True)
    there = (world.norm(dim=-1).amax(1) > 0) & person.found
    if not there.any():
        return guess, torch.zeros(len(guess))
    ends = [[marks.rows.index(end) for end in limb] for limb in _LIMBS]
    sizes = torch.stack([(world[there][:, a] - world[there][:, b]).norm(dim=-1) for a, b in ends])
    wanted = torch.stack([(rest[a] - rest[b]).norm() for a, b in ends])
    scale = float((wanted / sizes.median(dim=1).values.clamp(min=1e-3)).median())
    return torch.where(there[:, None, None], scale * world, guess), there.float()


def _standing(
    pixels: Float[Tensor, "F L 2"],
    confidences: Float[Tensor, "F L"],
    marks: LandmarkMap,
    extent: float,
    pace: Pace,
) -> Bool[Tensor, "G L"]:
    """Landmarks of feet that stand still in the picture, over two steps in a row."""
    way = (pixels[1:] - pixels[:-1]).norm(dim=-1)
    speed = way / (pace.steps.to(way.dtype)[:, None] * (extent * pace.interval))
    seen = torch.minimum(confidences[1:], confidences[:-1]) > 0.5
    slow = (speed < STANDING_SPEED) & seen
    feet = torch.tensor([row in FEET for row in marks.rows])
    if len(slow) < 2:
        return slow & feet
    padded = torch.cat([slow[:1], slow, slow[-1:]])
    return slow & (padded[:-2] | padded[2:]) & feet
