"""Retargeting: a motion of any humanoid skeleton as poses of SMPL's 24 joints.

Files differ in joint names, in axes, in what their zero pose is (some mixamo exports have all bones
along x) and in the local frames of joints. So nothing is taken from the zero pose alone: for each
joint a constant rotation `local_from_rest` is found that says how SMPL's T-pose would look in that
joint's own frame, from the directions of the bones and from how elbows and knees bend; then
`world_from_local @ local_from_rest` is the world rotation of SMPL's joint. Bones of arms and legs
point exactly as in the file, whatever the proportions.

The hips go where all joints above carry them: many files have a root that stands still and the
person's way in the positions of its child. Below the hips bones are rigid, as a person's are: a
joint that leaves its place there is named by `moving_bones` and read as if it did not. How it turns
is still right, and who refused it would refuse every rig whose shoulders slide a little.

Conventions. `Body`'s: +X to the person's left, +Y up, +Z forward. Everything in float64.
"""

import dataclasses

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.animation.driving_motion import BodyMotion, SkeletonMotion
from deblur_avatar.animation.rig_names import recognise
from deblur_avatar.artifacts.body import (
    SMPL_JOINT_NAMES,
    SMPL_PARENTS,
    Body,
)
from deblur_avatar.bodies.posed_body import shaped_joints
from deblur_avatar.errors import ArtifactError
from deblur_avatar.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle

STANDING = 0.25  # share of the frames, those with the ankle lowest, in which a foot is flat
MIN_BEND = 0.05  # mean sine of a hinge's angle, below which it tells nothing about the twist
LOOSE = 0.01  # of a leg's length: what a joint may leave its place by and count as resting there
LEG = (("left_hip", "left_knee"), ("left_knee", "left_ankle"))
_, UP, FORWARD = torch.eye(3, dtype=torch.float64)
_INDEX = {name: index for index, name in enumerate(SMPL_JOINT_NAMES)}


def retarget(motion: SkeletonMotion, body: Body, betas: Float[Tensor, " B"]) -> BodyMotion:
    """Turn a skeleton's motion into SMPL poses of one person.

    The person keeps its proportions; steps and jumps scale with the length of its legs. Toes and
    fingers stay straight. Collar bones and head move about their mean place, which is rest. Feet
    are level when they are low.

    Raises:
        ArtifactError: if a joint that is needed cannot be recognised by its name; lists both sides.
    """
    rig = recognise(motion.names, motion.parents)
    motion = _carried(motion, rig)
    rest = shaped_joints(body, betas).double()
    upright = _upright(motion, rig)
    turned = upright @ world_rotations(motion)
    places = world_positions(motion) @ upright.T
    fitted = _rest_frames(motion, rig, turned, places[..., 1], rest)
    local = _local_rotations(rig, turned, fitted)
    pelvis = places[:, rig["pelvis"]] * _scale(motion, rig, rest)
    axis_angle = matrix_to_axis_angle(local).to(betas.dtype)
    return BodyMotion(
        fps=motion.fps,
        global_orient=axis_angle[:, 0],
        body_pose=axis_angle[:, 1:],
        transl=(pelvis - rest[0]).to(betas.dtype),
    )


def moving_bones(motion: SkeletonMotion) -> tuple[str, ...]:
    """Joints below the hips that leave their place on their parents, which `retarget` ignores.

    Raises:
        ArtifactError: as `retarget`.
    """
    rig = recognise(motion.names, motion.parents)
    body = {step for joint in rig.values() for step in _path(motion, rig["pelvis"], joint)}
    return tuple(motion.names[joint] for joint in sorted(body & _off_their_place(motion, rig)))


def world_rotations(motion: SkeletonMotion) -> Float[Tensor, "F J 3 3"]:
    """Rotations of all joints' frames in the file's world."""
    world: list[Tensor] = []
    for joint, parent in enumerate(motion.parents):
        local = motion.rotations[:, joint].double()
        world.append(local if parent < 0 else world[parent] @ local)
    return torch.stack(world, dim=1)


def world_positions(motion: SkeletonMotion) -> Float[Tensor, "F J 3"]:
    """Positions of all joints in the file's world and unit."""
    turned = world_rotations(motion)
    places: list[Tensor] = []
    for joint, parent in enumerate(motion.parents):
        if parent < 0:
            places.append(motion.positions[joint].double())
        elif joint in motion.positions:
            local = motion.positions[joint].double()[..., None]
            places.append(places[parent] + (turned[:, parent] @ local)[..., 0])
        else:
            places.append(places[parent] + turned[:, parent] @ motion.offsets[joint].double())
    return torch.stack(places, dim=1)


def _carried(motion: SkeletonMotion, rig: dict[str, int]) -> SkeletonMotion:
    """Leave positions to the joints that carry the hips, where they say more than offsets do."""
    kept, joint = set(), rig["pelvis"]
    while motion.parents[joint] >= 0:
        kept.add(joint)
        joint = motion.parents[joint]
    kept = {joint} | (kept & _off_their_place(motion, rig))
    positions = {key: places for key, places in motion.positions.items() if key in kept}
    return dataclasses.replace(motion, positions=positions)


def _off_their_place(motion: SkeletonMotion, rig: dict[str, int]) -> set[int]:
    """Joints, other than roots, whose positions are not their offset all the time.

    Programs that write positions for all joints repeat the offset there, to 1e-5, or write zeros.
    """
    limit = LOOSE * _leg_length(motion, rig)

    def rests(joint: int) -> bool:
        places = motion.positions[joint].double()
        return any(
            float((places - place).norm(dim=-1).max()) <= limit
            for place in (motion.offsets[joint].double(), torch.zeros_like(places[0]))
        )

    return {joint for joint in motion.positions if motion.parents[joint] >= 0 and not rests(joint)}


def _upright(motion: SkeletonMotion, rig: dict[str, int]) -> Float[Tensor, "3 3"]:
    """Rotation that takes the file's vertical, along which heads are above feet, to +Y."""
    places = world_positions(motion)
    feet = (places[:, rig["left_ankle"]] + places[:, rig["right_ankle"]]) / 2
    height = (places[:, rig["head"]] - feet).mean(0)
    axis = int(height.abs().argmax())
    vertical = torch.zeros(3, dtype=torch.float64)
    vertical[axis] = 1.0 if height[axis] > 0 else -1.0
    return _swing(torch.eye(3, dtype=torch.float64), vertical, UP)


def _scale(motion: SkeletonMotion, rig: dict[str, int], rest: Tensor) -> float:
    """Length of the person's legs over that of the skeleton's."""
    ours = sum(float((rest[_INDEX[lower]] - rest[_INDEX[upper]]).norm()) for upper, lower in LEG)
    return ours / _leg_length(motion, rig)


def _leg_length(motion: SkeletonMotion, rig: dict[str, int]) -> float:
    """In the file's unit."""
    length = 0.0
    for upper, lower in LEG:
        length += sum(
            float(motion.offsets[step].norm()) for step in _path(motion, rig[upper], rig[lower])
        )
    return length


def _rest_frames(
    motion: SkeletonMotion, rig: dict[str, int], turned: Tensor, heights: Tensor, rest: Tensor
) -> dict[str, Tensor]:
    """`local_from_rest` of every recognised joint."""

    def aim(joint: str, target: str) -> Tensor:
        return _aim(motion, rig[joint], rig[target])

    def bone(joint: str, child: str) -> Tensor:
        return _unit(rest[_INDEX[child]] - rest[_INDEX[joint]])

    fitted = {
        "pelvis": _frame(
            aim("pelvis", "left_hip") - aim("pelvis", "right_hip"), aim("pelvis", "spine3")
        ),
        "spine3": _frame(
            aim("spine3", "left_shoulder") - aim("spine3", "right_shoulder"), aim("spine3", "head")
        ),
    }
    above = fitted["pelvis"]
    for joint, child in (("spine1", "spine2"), ("spine2", "spine3")):
        if joint in rig:
            above = _swing(above, UP, aim(joint, child if child in rig else "spine3"))
            fitted[joint] = above
    above = fitted["spine3"]
    if "neck" in rig:
        above = fitted["neck"] = _swing(above, UP, aim("neck", "head"))
    fitted["head"] = _mean_frame(turned, rig, "head", "neck" if "neck" in rig else "spine3", above)
    for side in ("left", "right"):
        hip, knee, ankle = f"{side}_hip", f"{side}_knee", f"{side}_ankle"
        thigh = _swing(fitted["pelvis"], bone(hip, knee), aim(hip, knee))
        shin = _direction(turned, rig[hip], rig[knee], aim(knee, ankle))
        fitted[hip] = _twist(thigh, bone(hip, knee), shin, bone(knee, ankle), -FORWARD)
        fitted[knee] = _swing(fitted[hip], bone(knee, ankle), aim(knee, ankle))
        low = heights[:, rig[ankle]]
        standing = turned[low <= low.quantile(STANDING), rig[ankle]]
        fitted[ankle] = _level(standing, _tip(motion, rig[ankle]), fitted[knee])
        shoulder, elbow, wrist = f"{side}_shoulder", f"{side}_elbow", f"{side}_wrist"
        arm = _swing(fitted["spine3"], bone(shoulder, elbow), aim(shoulder, elbow))
        forearm = _direction(turned, rig[shoulder], rig[elbow], aim(elbow, wrist))
        fitted[shoulder] = _twist(arm, bone(shoulder, elbow), forearm, bone(elbow, wrist), FORWARD)
        fitted[elbow] = _swing(fitted[shoulder], bone(elbow, wrist), aim(elbow, wrist))
        tip = _tip(motion, rig[wrist])
        hand = bone(wrist, f"{side}_hand")
        fitted[wrist] = fitted[elbow] if tip is None else _swing(fitted[elbow], hand, tip)
        collar = f"{side}_collar"
        if collar in rig:
            fitted[collar] = _mean_frame(turned, rig, collar, "spine3", fitted["spine3"])
    return fitted


def _local_rotations(
    rig: dict[str, int], turned: Tensor, fitted: dict[str, Tensor]
) -> Float[Tensor, "F 24 3 3"]:
    """Rotations relative to SMPL's parents; joints the file lacks go with their parents."""
    world: list[Tensor] = []
    local: list[Tensor] = []
    for joint, parent in enumerate(SMPL_PARENTS):
        name = SMPL_JOINT_NAMES[joint]
        here = turned[:, rig[name]] @ fitted[name] if name in fitted else world[parent]
        world.append(here)
        local.append(here if parent < 0 else world[parent].transpose(1, 2) @ here)
    return torch.stack(local, dim=1)


def _path(motion: SkeletonMotion, joint: int, target: int) -> list[int]:
    """Joints from below `joint` down to `target`."""
    path = []
    while target != joint:
        path.append(target)
        target = motion.parents[target]
    return path[::-1]


def _aim(motion: SkeletonMotion, joint: int, target: int) -> Tensor:
    """Where `target` lies as seen from `joint`'s own frame: the first bone that has a length."""
    for step in _path(motion, joint, target):
        if motion.offsets[step].norm() > 0:
            return _unit(motion.offsets[step].double())
    raise ArtifactError(
        f"the skeleton has no length between {motion.names[joint]} and {motion.names[target]}"
    )


def _hanging(motion: SkeletonMotion, joint: int) -> list[Tensor]:
    """Directions of the bones that start at a joint, in its frame."""
    bones = []
    for child in range(joint + 1, len(motion.names)):
        if motion.offsets[child].norm() > 0:
            parent = motion.parents[child]
            while parent > joint and motion.offsets[parent].norm() == 0:
                parent = motion.parents[parent]
            if parent == joint:
                bones.append(_unit(motion.offsets[child].double()))
    return bones


def _tip(motion: SkeletonMotion, joint: int) -> Tensor | None:
    """Of the bones that start at a joint the one most in line with all; None at a bare end."""
    bones = _hanging(motion, joint)
    mean = sum(bones, torch.zeros(3, dtype=torch.float64))
    return max(bones, key=lambda bone: float(bone @ mean), default=None)


def _direction(turned: Tensor, joint: int, child: int, bone: Tensor) -> Float[Tensor, "F 3"]:
    """Direction of the child's bone in the joint's frame."""
    return turned[:, joint].transpose(1, 2) @ turned[:, child] @ bone


def _unit(vector: Tensor) -> Tensor:
    return torch.nn.functional.normalize(vector, dim=-1)


def _frame(left: Tensor, up: Tensor) -> Tensor:
    """Rotation that takes +X to `left` and +Y as near to `up` as that allows."""
    x = _unit(left)
    y = _unit(up - (up @ x) * x)
    return torch.stack([x, y, torch.linalg.cross(x, y)], dim=1)


def _swing(frame: Tensor, bone: Tensor, wanted: Tensor) -> Tensor:
    """Turn `frame` by the least angle that makes it take `bone` to `wanted`."""
    now = frame @ bone
    axis = torch.linalg.cross(now, wanted)
    sine, cosine = axis.norm(), now @ wanted
    if sine < 1e-9:
        if cosine > 0:
            return frame
        axis = torch.linalg.cross(now, torch.eye(3, dtype=now.dtype)[now.abs().argmin()])
    return axis_angle_to_matrix(torch.atan2(sine, cosine) * _unit(axis)) @ frame


def _twist(frame: Tensor, bone: Tensor, below: Tensor, straight: Tensor, pole: Tensor) -> Tensor:
    """Turn `frame` about `bone` so that the joint below bends towards `pole` on average.

    `below` [F,3] is the next bone as the joint's own frame sees it, `straight` the same bone in the
    T-pose. A hinge leaves the part of that bone along its axis as it is.
    """
    bend = (below @ frame).mean(0)
    bend = bend - (bend @ bone) * bone
    side = _unit(pole - (pole @ bone) * bone)
    hinge = torch.linalg.cross(bone, side)
    along = straight @ hinge
    if bend.norm() < max(MIN_BEND, 1.01 * float(along.abs())):
        return frame
    wanted = (bend @ bend - along**2).sqrt() * side + along * hinge
    angle = torch.atan2(torch.linalg.cross(wanted, bend) @ bone, wanted @ bend)
    return frame @ axis_angle_to_matrix(angle * bone)


def _level(turned: Tensor, toes: Tensor | None, shin: Tensor) -> Tensor:
    """Frame of a foot whose sole is level on average and whose toes are in front.

    `turned` holds its rotations while it stands; `shin` is the answer where they tell nothing.
    """
    up = turned.transpose(1, 2).mean(0) @ UP
    if toes is None or up.norm() < MIN_BEND:
        return shin
    up = _unit(up)
    ahead = _unit(toes - (toes @ up) * up)
    return torch.stack([torch.linalg.cross(up, ahead), up, ahead], dim=1)


def _mean_frame(
    turned: Tensor, rig: dict[str, int], joint: str, parent: str, frame_of_parent: Tensor
) -> Tensor:
    """Frame of a joint whose mean place over the clip, as seen from its parent, is rest.

    The mean is the rotation nearest to the mean of the matrices.
    """
    above = turned[:, rig[parent]] @ frame_of_parent
    u, _, vh = torch.linalg.svd((turned[:, rig[joint]].transpose(1, 2) @ above).mean(0))
    sign = torch.ones(3, dtype=u.dtype)
    sign[2] = torch.linalg.det(u @ vh)
    return u @ torch.diag(sign) @ vh
