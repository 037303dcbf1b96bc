"""Body fitting: one shape, and one pose a frame, from one or several cameras' landmarks.

Landmarks in space, triangulated or (one view) lifted, bring the body near; their projections and
the mattes' outlines then refine it. Hands and face that were looked for say which way theirs look.
Motion is a spline over the clip, solved for all frames at once. Terms are squared distances in
standard deviations; those of pictures saturate, since detectors are not noisy but wrong.
"""

import logging
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from deblur_avatar import run
from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES, Body
from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import shaped_joints
from deblur_avatar.body_estimation.body_landmarks import LandmarkMap, landmark_map
from deblur_avatar.body_estimation.first_guess import first_guess, spline_basis
from deblur_avatar.body_estimation.fit_rates import fit_rates
from deblur_avatar.body_estimation.landmark_track import size_in_pictures
from deblur_avatar.body_estimation.landmarks import Landmarks
from deblur_avatar.body_estimation.monocular_prior import (
    OneView,
    apply_monocular_prior,
    guess_cost,
    standing_cost,
)
from deblur_avatar.body_estimation.pace import Pace, pace_of, second_differences
from deblur_avatar.body_estimation.part_fit import (
    PART_LANDMARKS,
    PART_MAP,
    Parts,
    gather_parts,
    part_cost,
)
from deblur_avatar.body_estimation.pose_limits import PoseLimits, pose_limits
from deblur_avatar.body_estimation.robust_costs import growing, saturating
from deblur_avatar.body_estimation.silhouettes import (
    Silhouettes,
    distance_outside,
    nearest_points,
    silhouettes,
)
from deblur_avatar.body_estimation.surface_samples import SurfaceSamples, sample_evenly
from deblur_avatar.body_estimation.triangulation import Triangulated, check_agreement, triangulate
from deblur_avatar.errors import ArtifactError
from deblur_avatar.geometry.cameras import project
from deblur_avatar.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from deblur_avatar.geometry.skinning import forward_kinematics, skin_points

logger = logging.getLogger(__name__)

# Standard deviations. Those in shares are of the person's size in the picture.
LANDMARK_M = 0.03
LANDMARK_SHARE = 0.015
OUTLINE_SHARE = 0.01
ACCELERATION = 60.0  # of joints, m/s^2: a kick's
ANGULAR_ACCELERATION = 300.0  # of joints' rotations, rad/s^2
SHAPE_TRUST = 1.0  # how many measurements of a frame the expected shape weighs
OFFSET_TRUST = 0.2  # the same of where landmarks are expected on the body (decision 59)
BEYOND_LIMIT = 0.1  # radians
KNOT_SECONDS = 1 / 15  # between the knots of the splines that all motion is
OUTLIER_SHARE = 0.05  # beyond this a view does not take part in triangulation
OUTLINE_WEIGHT = 40.0  # landmarks that one matte counts as

SURFACE_POINTS = 1200  # that outlines are matched to
COARSE_STEPS = 150  # with few outlines; the error has settled by then on all clips tried
FINE_STEPS = 200  # with all of them
OUTLINED_FRAMES = 64  # of one view that a step compares with their mattes
MATCH_EVERY = 25  # steps between two searches for outline points' partners
RATES = {
    "betas": 0.2, "turn": 0.05, "body_pose": 0.08, "transl": 0.02, "offsets": 0.004,
    "part_offsets": 0.004,
}  # fmt: skip


class BodyFit(NamedTuple):
    """Poses, and how well they explain what was seen."""

    poses: Poses
    residuals: Float[Tensor, "V F L"]  # pixels, of used landmarks; 0 where not seen
    extent: float  # the person's median size in the pictures, pixels
    trust: Float[Tensor, " F"]  # in [0, 1], how far a frame's pose rests on what was seen
    flags: dict[str, int]  # landmarks found wrong, by kind; of one view alone
    parts: dict[str, float]  # share of the views' frames with each hand and the face, if asked for


class _Unknowns(NamedTuple):
    """What is solved for: D knots' control values of all that moves."""

    betas: Float[Tensor, " B"]
    turn: Float[Tensor, "D 3"]  # of the whole body about its first guess, so that no angle wraps
    body_pose: Float[Tensor, "D 3*K"]
    transl: Float[Tensor, "D 3"]
    offsets: Float[Tensor, "M 3"]  # of landmarks
    part_offsets: Float[Tensor, "N 3"]  # of points of hands and face


class _Posed(NamedTuple):
    """The body that a set of unknowns describes; metres, radians."""

    turn: Float[Tensor, "F 3"]
    body_pose: Float[Tensor, "F K 3"]
    transl: Float[Tensor, "F 3"]
    transforms: Float[Tensor, "F J 4 4"]  # rest to posed
    joints: Float[Tensor, "F J 3"]
    landmarks: Float[Tensor, "F L 3"]
    rest: Float[Tensor, "J 3"]  # of this person


@dataclass(frozen=True)
class _Problem:
    """What does not change while the body is fitted."""

    body: Body
    surface: SurfaceSamples
    marks: LandmarkMap
    limits: PoseLimits
    Ks: Float[Tensor, "V 3 3"]
    viewmats: Float[Tensor, "V 4 4"]
    pixels: Float[Tensor, "V F L 2"]
    confidences: Float[Tensor, "V F L"]
    found: Triangulated
    one: OneView | None
    parts: Parts | None
    outlines: Silhouettes
    orient: Float[Tensor, "F 3 3"]  # first guess
    basis: Float[Tensor, "F D"]  # frames from control values
    pace: Pace
    extent: float  # the person's size in the pictures, pixels
    any_pose: bool


@run.one_thread()
def fit_body(
    body: Body,
    cameras: Cameras,
    recorded: tuple[int, ...],
    people: list[Landmarks],
    timestamps: Float[Tensor, " F"],
    *,
    any_pose: bool = False,
) -> BodyFit:
    """Fit a body to what detectors found in several cameras' frames.

    Args:
        body: with SMPL's 24 joints.
        cameras: without distortion.
        recorded: the camera of each entry of `people`.
        people: landmarks and mattes in the pixels of those cameras.
        timestamps: of the frames, seconds.
        any_pose: the person may sit and lie (decision 65), not only stand and walk.

    Raises:
        ArtifactError: if no frame shows a person, or no two of several cameras agree on her.
    """
    if body.joint_names != SMPL_JOINT_NAMES:
        raise ArtifactError("poses can be estimated only for bodies with SMPL's 24 joints")
    if not any(bool(person.found.any()) for person in people):
        raise ArtifactError("no person found in any frame; check the videos")
    problem, transl = _problem(body, cameras, recorded, people, timestamps, any_pose)
    unknowns = _solve(problem, transl)
    posed = _pose(problem, unknowns)
    poses = Poses(
        betas=unknowns.betas,
        global_orient=matrix_to_axis_angle(problem.orient @ axis_angle_to_matrix(posed.turn)),
        body_pose=posed.body_pose,
        transl=posed.transl,
    )
    lenses = zip(problem.Ks, problem.viewmats, strict=True)
    projected = [project(posed.landmarks, *camera)[0] for camera in lenses]
    residuals = (torch.stack(projected) - problem.pixels).norm(dim=-1)
    prior = problem.one
    if prior is None:
        trust = torch.stack([person.found for person in people]).any(0).float()
    else:
        trust = prior.trust
    return BodyFit(
        poses=poses,
        residuals=residuals * (problem.confidences > 0),
        extent=problem.extent,
        trust=trust,
        flags={} if prior is None else prior.flags,
        parts={} if problem.parts is None else problem.parts.shares(),
    )


def _problem(
    body: Body,
    cameras: Cameras,
    recorded: tuple[int, ...],
    people: list[Landmarks],
    timestamps: Float[Tensor, " F"],
    any_pose: bool,
) -> tuple[_Problem, Float[Tensor, "D 3"]]:
    """What is known before the body is fitted, and a first guess of the root's control points."""
    marks = landmark_map()
    rows, views = list(marks.rows), list(recorded)
    pace = pace_of(timestamps)
    basis = spline_basis(pace, KNOT_SECONDS)
    extent, one = size_in_pictures(people, any_pose=any_pose), None
    if len(recorded) == 1:
        person, one = apply_monocular_prior(
            body, marks, people[0], cameras, recorded[0], basis, extent, pace,
            any_pose=any_pose,
        )  # fmt: skip
        people = [person]
    pixels = torch.stack([person.points[:, rows] for person in people])
    confidences = torch.stack(
        [person.visibility[:, rows] * person.found[:, None] for person in people]
    )
    Ks, viewmats = cameras.Ks[views], cameras.viewmats[views]
    if one is None:
        found = triangulate(pixels, confidences, Ks, viewmats, OUTLIER_SHARE * extent)
        check_agreement(found, confidences, [cameras.names[index] for index in recorded])
    else:
        found = one.found
    carriers = [marks.rows.index(row) for row in PART_LANDMARKS]
    parts = gather_parts(people, found.inliers[..., carriers])
    orient, transl = first_guess(body, marks, found, basis)
    problem = _Problem(
        body=body,
        surface=sample_evenly(body, SURFACE_POINTS),
        marks=marks,
        limits=pose_limits(() if parts is None else parts.hands_seen()),
        Ks=Ks,
        viewmats=viewmats,
        pixels=pixels,
        confidences=confidences,
        found=found,
        one=one,
        parts=parts,
        outlines=silhouettes([person.mattes for person in people]),
        orient=orient,
        basis=basis,
        pace=pace,
        extent=extent,
        any_pose=any_pose,
    )
    return problem, transl


def _pose(problem: _Problem, unknowns: _Unknowns) -> _Posed:
    body = problem.body
    turn, transl = problem.basis @ unknowns.turn, problem.basis @ unknowns.transl
    body_pose = (problem.basis @ unknowns.body_pose).unflatten(1, (-1, 3))
    joints = shaped_joints(body, unknowns.betas)
    orient = problem.orient @ axis_angle_to_matrix(turn)
    rotations = torch.cat([orient[:, None], axis_angle_to_matrix(body_pose)], dim=1)
    transforms = forward_kinematics(rotations, joints, transl, body.parents)
    return _Posed(
        turn=turn,
        body_pose=body_pose,
        transl=transl,
        transforms=transforms,
        joints=(transforms[..., :3, :3] @ joints[..., None])[..., 0] + transforms[..., :3, 3],
        landmarks=problem.marks.positions(transforms, joints, unknowns.offsets),
        rest=joints,
    )


def _posed_surface(
    problem: _Problem, betas: Float[Tensor, " B"], posed: _Posed, frames: slice
) -> Float[Tensor, "E P 3"]:
    surface = problem.surface
    points = surface.points + surface.shape_dirs @ betas
    return skin_points(points, surface.lbs_weights, posed.transforms[frames])


def _solve(problem: _Problem, transl: Float[Tensor, "D 3"]) -> _Unknowns:
    """First by landmarks in space, then by what the pictures show."""
    knots, joints = len(transl), len(problem.body.parents)
    unknowns = _Unknowns(
        betas=torch.zeros(problem.body.shape_dirs.shape[2], requires_grad=True),
        turn=torch.zeros(knots, 3, requires_grad=True),
        body_pose=torch.zeros(knots, 3 * (joints - 1), requires_grad=True),
        transl=transl.clone().requires_grad_(),
        offsets=problem.marks.offsets.clone().requires_grad_(),
        part_offsets=PART_MAP.offsets.clone().requires_grad_(),
    )
    groups = [{"params": [value], "lr": RATES[name]} for name, value in unknowns._asdict().items()]
    optimiser = torch.optim.Adam(groups)
    steps = COARSE_STEPS + FINE_STEPS
    schedule = fit_rates(optimiser, COARSE_STEPS, FINE_STEPS)
    partners: list[Int64[Tensor, "F Q"]] = []
    # Outlines cost most; of a long clip each step looks at some of the frames.
    stride = 1 if problem.one is None else -(-len(problem.basis) // OUTLINED_FRAMES)
    for step in run.progress(range(steps), "body fit"):
        posed = _pose(problem, unknowns)
        loss = _priors(problem, unknowns, posed)
        if problem.one is not None:
            loss = loss + guess_cost(problem.one, problem.marks, posed.landmarks)
            loss = loss + standing_cost(problem.one, posed.landmarks, problem.pace)
        if problem.parts is not None:
            places = PART_MAP.positions(posed.transforms, posed.rest, unknowns.part_offsets)
            # From the rest pose every palm looks the wrong way.
            robust = growing if step < COARSE_STEPS else saturating
            loss = loss + part_cost(problem.parts, places, problem.Ks, problem.viewmats, robust)
        if step < COARSE_STEPS:
            loss = loss + _landmarks_in_space(problem, posed)
        else:
            if (step - COARSE_STEPS) % MATCH_EVERY == 0:
                with torch.no_grad():
                    surface = _posed_surface(problem, unknowns.betas, posed, slice(None))
                partners = _partners(problem, surface)
            frames = slice(step % stride, None, stride)
            surface = _posed_surface(problem, unknowns.betas, posed, frames)
            loss = loss + _landmarks_in_pictures(problem, posed)
            loss = loss + stride * _outlines(problem, surface, partners, frames)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    return _Unknowns(*[value.detach() for value in unknowns])


def _landmarks_in_space(problem: _Problem, posed: _Posed) -> Float[Tensor, ""]:
    found = problem.found
    squared = (posed.landmarks - found.points).square().sum(-1) / LANDMARK_M**2
    trust = (problem.confidences * found.inliers).sum(0)
    # Unlike the pictures' terms: from the rest pose every hand is an outlier.
    return (trust * growing(squared)).sum()


def _landmarks_in_pictures(problem: _Problem, posed: _Posed) -> Float[Tensor, ""]:
    """Landmarks in every view."""
    total = posed.joints.new_zeros(())
    for view, camera in enumerate(zip(problem.Ks, problem.viewmats, strict=True)):
        marks, _ = project(posed.landmarks, *camera)
        squared = (marks - problem.pixels[view]).square().sum(-1)
        squared = squared / (LANDMARK_SHARE * problem.extent) ** 2
        total = total + (problem.confidences[view] * saturating(squared)).sum()
    return total


def _outlines(
    problem: _Problem,
    points: Float[Tensor, "E P 3"],
    partners: list[Int64[Tensor, "F Q"]],
    frames: slice,
) -> Float[Tensor, ""]:
    """Outlines both ways, in every view, of some frames."""
    total = points.new_zeros(())
    outlines, sigma = problem.outlines, OUTLINE_SHARE * problem.extent
    for view, camera in enumerate(zip(problem.Ks, problem.viewmats, strict=True)):
        surface, _ = project(points, *camera)
        outside = distance_outside(outlines.outside[view, frames], surface) / sigma
        partner = partners[view][frames, :, None].expand(-1, -1, 2)
        gap = outlines.outline[view, frames] - surface.gather(1, partner)
        along = (gap * outlines.normals[view, frames]).sum(-1) / sigma
        both = saturating(outside.square()).mean(1) + saturating(along.square()).mean(1)
        total = total + OUTLINE_WEIGHT * (both * outlines.shown[view, frames]).sum()
    return total


def _partners(problem: _Problem, points: Float[Tensor, "F P 3"]) -> list[Int64[Tensor, "F Q"]]:
    return [
        nearest_points(outline, project(points, K, viewmat)[0])
        for outline, K, viewmat in zip(
            problem.outlines.outline, problem.Ks, problem.viewmats, strict=True
        )
    ]


def _priors(problem: _Problem, unknowns: _Unknowns, posed: _Posed) -> Float[Tensor, ""]:
    """What is known of bodies: shapes, smooth motion, limits of joints."""
    limits, marks = problem.limits, problem.marks
    pose = posed.body_pose
    beyond = (limits.low - pose).clamp(min=0) + (pose - limits.high).clamp(min=0)
    relaxed = (pose / limits.std[:, None]).square()
    if problem.any_pose:  # who sits or lies has joints far from rest, and should not pay for it
        relaxed = growing(relaxed)
    away = (unknowns.offsets - marks.offsets) / marks.stds[:, None]
    part_away = (unknowns.part_offsets - PART_MAP.offsets) / PART_MAP.stds[:, None]
    pace, step = problem.pace, problem.pace.interval**2
    acceleration = second_differences(posed.joints, pace) / (ACCELERATION * step)
    rotations = torch.cat([posed.turn[:, None], pose], dim=1)
    angular = second_differences(rotations, pace) / (ANGULAR_ACCELERATION * step)
    # What is one for the clip is weighed against as many measurements as there are frames.
    shape = len(pose) ** 0.5 * SHAPE_TRUST * unknowns.betas
    offsets = len(pose) ** 0.5 * OFFSET_TRUST * torch.cat([away, part_away])
    squares = [term.square() for term in (shape, offsets)] + [relaxed]
    squares += [term.square() for term in (beyond / BEYOND_LIMIT, acceleration, angular)]
    return torch.stack([square.sum() for square in squares]).sum()
