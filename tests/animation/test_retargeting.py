import dataclasses
import os
from pathlib import Path

import pytest
import torch

from deblur_avatar.animation.bvh import read_bvh
from deblur_avatar.animation.driving_motion import SkeletonMotion
from deblur_avatar.animation.retargeting import moving_bones, retarget, world_positions
from deblur_avatar.animation.rig_names import recognise
from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES, SMPL_PARENTS
from deblur_avatar.bodies.posed_body import (
    joint_transforms,
    posed_joints,
    shaped_joints,
)
from deblur_avatar.errors import ArtifactError
from deblur_avatar.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle

MOCAP = Path(os.environ.get("MOCAP_ROOT", Path(__file__).parents[3] / "shared/data/mocap"))
INDEX = {name: index for index, name in enumerate(SMPL_JOINT_NAMES)}
MIXAMO = (
    "Hips", "LeftUpLeg", "RightUpLeg", "Spine", "LeftLeg", "RightLeg", "Spine1", "LeftFoot",
    "RightFoot", "Spine2", "LeftToeBase", "RightToeBase", "Neck", "LeftShoulder", "RightShoulder",
    "Head", "LeftArm", "RightArm", "LeftForeArm", "RightForeArm", "LeftHand", "RightHand",
    "LeftHandMiddle1", "RightHandMiddle1",
)  # fmt: skip
GROWS = torch.tensor([1.0, 0.0])  # the first shape number scales the body, as capsules' does
LIMBS = [
    (f"{side}_{upper}", f"{side}_{lower}")
    for side in ("left", "right")
    for upper, lower in (
        ("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"),
    )
]  # fmt: skip


def acted(frames=40, seed=0):
    """SMPL poses of someone who dances on the spot: hinges bend one way only, feet stand level."""
    generator = torch.Generator().manual_seed(seed)
    time = torch.linspace(0, 6, frames).double()

    def wave(size):
        phase = 6.28 * torch.rand(3, generator=generator).double()
        return size * torch.sin(time[:, None] * torch.tensor([1.0, 1.3, 0.7]) + phase)

    pose = torch.zeros(frames, 24, 3).double()
    pose[:, 0] = torch.stack([0 * time, time / 4, 0 * time], 1)
    for joint in ("left_hip", "right_hip", "left_shoulder", "right_shoulder"):
        pose[:, INDEX[joint]] = wave(0.6)
    for joint in ("spine3", "neck", "left_wrist", "right_wrist"):
        pose[:, INDEX[joint]] = wave(0.3)
    pose[:, INDEX["left_knee"], 0] = 0.6 + wave(0.5)[:, 0]
    pose[:, INDEX["right_knee"], 0] = 0.5 + wave(0.4)[:, 0]
    pose[:, INDEX["left_elbow"], 1] = -0.7 + wave(0.5)[:, 0]
    pose[:, INDEX["right_elbow"], 1] = 0.8 + wave(0.4)[:, 0]
    transl = torch.stack([0.1 * time, 1 + 0.1 * torch.sin(time), 0.2 * time], 1)
    return pose, transl


def as_rig(body, pose, transl, *, frames_of_joints, turn=None, unit=1.0, names=MIXAMO):
    """The same movement of the same bones, told in other local frames, axes and units.

    `frames_of_joints` [24,3,3] are the local frames in the T-pose, as seen from the world.
    """
    turn = torch.eye(3).double() if turn is None else turn
    rest = shaped_joints(body, torch.zeros(2)).double()
    transforms = joint_transforms(body, torch.zeros(2).double(), pose[:, 0], pose[:, 1:], transl)
    world = turn @ transforms[..., :3, :3] @ frames_of_joints
    local, offsets = [], []
    for joint, parent in enumerate(SMPL_PARENTS):
        above = world[:, parent].mT if parent >= 0 else torch.eye(3).double()
        local.append(above @ world[:, joint])
        bone = rest[joint] - rest[parent] if parent >= 0 else rest[joint]
        frame = frames_of_joints[parent].mT if parent >= 0 else turn
        offsets.append(frame @ bone * unit)
    return SkeletonMotion(
        fps=30.0, names=names, parents=SMPL_PARENTS, offsets=torch.stack(offsets),
        rotations=torch.stack(local, 1),
        positions={0: (transl + rest[0]) @ turn.T * unit},
    )  # fmt: skip


def under_a_reference(motion, *, moves=False):
    """The same under a new root, which stands still somewhere or moves; its child has the way.

    The child's offset is of another pose, as Bandai Namco's files have it.
    """
    frames = len(motion.rotations)
    time = torch.linspace(0, 1, frames).double() if moves else torch.ones(frames).double()
    turned = axis_angle_to_matrix(time[:, None] * torch.tensor([0.3, -0.8, 0.5]).double())
    place = time[:, None] * torch.tensor([40.0, -10.0, 30.0]).double()
    below = turned.mT @ motion.rotations[:, 0]
    offsets = motion.offsets.clone()
    offsets[0] = torch.tensor([0.8, 94.0, -452.0])
    return dataclasses.replace(
        motion,
        names=("Reference", *motion.names),
        parents=(-1, *(parent + 1 for parent in motion.parents)),
        offsets=torch.cat([torch.zeros(1, 3).double(), offsets]),
        rotations=torch.cat([turned[:, None], below[:, None], motion.rotations[:, 1:]], 1),
        positions={0: place, 1: (turned.mT @ (motion.positions[0] - place)[..., None])[..., 0]},
    )


def odd_frames(seed):
    """Any local frames: left limbs, right limbs and the trunk have one each, as in exports."""
    generator = torch.Generator().manual_seed(seed)
    turns = axis_angle_to_matrix(torch.randn(5, 3, generator=generator).double())
    groups = torch.zeros(24, dtype=torch.long)
    for joint, name in enumerate(SMPL_JOINT_NAMES):
        arm = any(part in name for part in ("shoulder", "elbow", "wrist", "hand"))
        leg = any(part in name for part in ("hip", "knee", "ankle", "foot"))
        groups[joint] = (0 if not arm and not leg else 1 if arm else 3) + name.startswith("right")
    return turns[groups] if seed else torch.eye(3).double().repeat(24, 1, 1)


@pytest.fixture
def upright_body(body):
    """A body whose trunk is a straight line, as rest is taken to be."""
    joints = body.joints.clone()
    for name in ("spine1", "spine2", "spine3", "neck", "head"):
        joints[INDEX[name], [0, 2]] = 0.0
    return dataclasses.replace(body, joints=joints, joint_dirs=0.05 * joints[..., None] * GROWS)


def angles_between(a, b):
    a, b = torch.nn.functional.normalize(a, dim=-1), torch.nn.functional.normalize(b, dim=-1)
    return torch.rad2deg(2 * torch.asin(((a - b).norm(dim=-1) / 2).clamp(max=1)))


def bones(places, pairs, index):
    return torch.stack([places[:, index[b]] - places[:, index[a]] for a, b in pairs], 1)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_limbs_point_as_in_the_file_whatever_its_local_frames(body, seed):
    pose, transl = acted()
    motion = as_rig(body, pose, transl, frames_of_joints=odd_frames(seed), unit=100.0)
    made = retarget(motion, body, torch.zeros(2))
    got = posed_joints(body, torch.zeros(2), made.global_orient, made.body_pose, made.transl)
    want = posed_joints(body, torch.zeros(2).double(), pose[:, 0], pose[:, 1:], transl)
    difference = angles_between(bones(got.double(), LIMBS, INDEX), bones(want, LIMBS, INDEX))
    assert difference.max() < 0.1


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_rotations_come_back_where_bones_and_hinges_tell_them(upright_body, seed):
    pose, transl = acted()
    motion = as_rig(upright_body, pose, transl, frames_of_joints=odd_frames(seed), unit=100.0)
    made = retarget(motion, upright_body, torch.zeros(2))
    got = axis_angle_to_matrix(torch.cat([made.global_orient[:, None], made.body_pose], 1).double())
    relative = got.mT @ axis_angle_to_matrix(pose)
    error = torch.rad2deg(matrix_to_axis_angle(relative).norm(dim=-1)).amax(0)
    for name in ("pelvis", "spine1", "spine3", "neck", "head", "left_collar", "right_collar"):
        assert error[INDEX[name]] < 0.1, name
    for side in ("left", "right"):
        for name in ("hip", "knee", "shoulder", "elbow"):  # hinges not quite across their bones
            assert error[INDEX[f"{side}_{name}"]] < 1.0, (side, name)


def test_pelvis_and_jumps_scale_with_the_legs(body):
    pose, transl = acted()
    motion = as_rig(body, pose, transl, frames_of_joints=odd_frames(1), unit=39.37)  # inches
    tall = torch.tensor([4.0, 0.0])  # 20 % larger
    made = retarget(motion, body, tall)
    rest = shaped_joints(body, torch.zeros(2))[0]
    got = made.transl + shaped_joints(body, tall)[0]
    torch.testing.assert_close(got, (1.2 * (transl + rest)).float(), atol=1e-4, rtol=0)


@pytest.mark.parametrize("moves", [False, True])
def test_hips_go_where_the_joints_above_carry_them(body, moves):
    pose, transl = acted()
    motion = as_rig(body, pose, transl, frames_of_joints=odd_frames(1), unit=100.0)
    carried = under_a_reference(motion, moves=moves)
    plain = retarget(motion, body, torch.zeros(2))
    made = retarget(carried, body, torch.zeros(2))
    assert (plain.transl.amax(0) - plain.transl.amin(0)).min() > 0.1  # it does travel
    torch.testing.assert_close(made.transl, plain.transl, atol=1e-5, rtol=0)
    torch.testing.assert_close(made.global_orient, plain.global_orient, atol=1e-5, rtol=0)
    torch.testing.assert_close(made.body_pose, plain.body_pose, atol=1e-5, rtol=0)
    assert moving_bones(carried) == ()


@pytest.mark.parametrize("written", ["offsets", "zeros"])
def test_positions_of_joints_that_rest_change_nothing(body, written):
    pose, transl = acted()
    rig = as_rig(body, pose, transl, frames_of_joints=odd_frames(1), unit=100.0)
    carried = under_a_reference(rig, moves=True)
    motion = dataclasses.replace(carried, positions={0: carried.positions[0]})  # hips rest, too
    noise = 1e-5 * torch.randn(len(pose), 25, 3, generator=torch.Generator().manual_seed(0))
    resting = noise + (motion.offsets if written == "offsets" else 0)
    everywhere = {joint: resting[:, joint] for joint in range(25)} | motion.positions
    made = retarget(dataclasses.replace(motion, positions=everywhere), body, torch.zeros(2))
    plain = retarget(motion, body, torch.zeros(2))
    assert torch.equal(made.transl, plain.transl)
    assert torch.equal(made.body_pose, plain.body_pose)
    assert moving_bones(dataclasses.replace(motion, positions=everywhere)) == ()


def test_joints_below_the_hips_that_leave_their_place_are_named(body):
    pose, transl = acted()
    motion = as_rig(body, pose, transl, frames_of_joints=odd_frames(1), unit=100.0)
    loose = {
        joint: motion.offsets[joint] + torch.linspace(0, size, len(pose)).double()[:, None]
        for joint, size in ((9, 5.0), (16, 5.0), (17, 0.01), (23, 5.0))  # the last is a finger's
    }
    sliding = dataclasses.replace(motion, positions=motion.positions | loose)
    assert moving_bones(sliding) == ("Spine2", "LeftArm")
    made, plain = (retarget(one, body, torch.zeros(2)) for one in (sliding, motion))
    assert torch.equal(made.body_pose, plain.body_pose)


def test_any_vertical_axis_is_stood_upright(body):
    pose, transl = acted()
    plain = retarget(
        as_rig(body, pose, transl, frames_of_joints=odd_frames(1)), body, torch.zeros(2)
    )
    for turn in ([torch.pi / 2, 0, 0], [-torch.pi / 2, 0, 0], [0, 0, torch.pi / 2]):
        turned = axis_angle_to_matrix(torch.tensor(turn).double())
        motion = as_rig(body, pose, transl, frames_of_joints=odd_frames(1), turn=turned)
        made = retarget(motion, body, torch.zeros(2))
        torch.testing.assert_close(made.body_pose, plain.body_pose, atol=1e-4, rtol=0)
        torch.testing.assert_close(made.transl[:, 1], plain.transl[:, 1], atol=1e-4, rtol=0)
        up = axis_angle_to_matrix(made.global_orient)[..., 1, 1]
        torch.testing.assert_close(up, torch.ones_like(up), atol=1e-2, rtol=0)


def test_a_person_who_stands_in_the_t_pose_stays_in_it(upright_body):
    pose = torch.zeros(3, 24, 3).double()
    motion = as_rig(upright_body, pose, torch.zeros(3, 3).double(), frames_of_joints=odd_frames(0))
    made = retarget(motion, upright_body, torch.zeros(2))
    angles = torch.rad2deg(torch.cat([made.global_orient[:, None], made.body_pose], 1).norm(dim=-1))
    feet = [INDEX["left_ankle"], INDEX["right_ankle"]]
    assert angles[:, feet].max() < 6  # toes that point a little outwards are set straight
    angles[:, feet] = 0
    assert angles.max() < 0.1


def test_rokokos_names_are_recognised_with_their_prefix_and_neck_and_collars_by_place():
    names = [f"mixamorig:{name}" for name in MIXAMO]
    found = recognise(names, SMPL_PARENTS)
    assert {k: SMPL_JOINT_NAMES[v] for k, v in found.items()} == {k: k for k in found}
    assert len(found) == 20  # all but toes and hands


def test_cmus_names_are_recognised_with_joints_in_between():
    names = (
        "Hips", "LHipJoint", "LeftUpLeg", "LeftLeg", "LeftFoot", "RHipJoint", "RightUpLeg",
        "RightLeg", "RightFoot", "LowerBack", "Spine", "Spine1", "Neck", "Neck1", "Head",
        "LeftShoulder", "LeftArm", "LeftForeArm", "LeftHand", "RightShoulder", "RightArm",
        "RightForeArm", "RightHand",
    )  # fmt: skip
    parents = (-1, 0, 1, 2, 3, 0, 5, 6, 7, 0, 9, 10, 11, 12, 13, 11, 15, 16, 17, 11, 19, 20, 21)
    found = {joint: names[index] for joint, index in recognise(names, parents).items()}
    assert found["spine1"] == "LowerBack"
    assert found["spine2"] == "Spine"
    assert found["spine3"] == "Spine1"
    assert found["neck"] == "Neck"
    assert found["left_collar"] == "LeftShoulder"
    assert found["left_shoulder"] == "LeftArm"


def test_old_biovision_names_have_their_upper_arm_at_the_shoulder():
    names = (
        "Hips", "LeftHip", "LeftKnee", "LeftAnkle", "RightHip", "RightKnee", "RightAnkle", "Chest",
        "Head", "LeftCollar", "LeftShoulder", "LeftElbow", "LeftWrist", "RightCollar",
        "RightShoulder", "RightElbow", "RightWrist",
    )  # fmt: skip
    parents = (-1, 0, 1, 2, 0, 4, 5, 0, 7, 7, 9, 10, 11, 7, 13, 14, 15)
    found = {joint: names[index] for joint, index in recognise(names, parents).items()}
    assert found["spine3"] == "Chest"
    assert found["left_shoulder"] == "LeftShoulder"
    assert found["left_collar"] == "LeftCollar"
    assert "spine1" not in found
    assert "neck" not in found


SIDES_LAST = {
    "with a full stop": {
        "hip": "thigh.{}", "knee": "shin.{}", "ankle": "foot.{}",
        "shoulder": "upper_arm.{}", "elbow": "forearm.{}", "wrist": "hand.{}",
    },
    "Bandai Namco": {
        "hip": "UpperLeg_{}", "knee": "LowerLeg_{}", "ankle": "Foot_{}",
        "shoulder": "UpperArm_{}", "elbow": "LowerArm_{}", "wrist": "Hand_{}",
    },
}  # fmt: skip


@pytest.mark.parametrize("convention", SIDES_LAST)
def test_names_with_their_side_at_the_end_are_recognised(convention):
    forms = SIDES_LAST[convention]
    names = [
        forms[limb].format(side[0].upper()) if (limb := joint.removeprefix(f"{side}_")) in forms
        else {"pelvis": "Hips", "head": "Head"}.get(joint, f"bone {joint}")
        for joint in SMPL_JOINT_NAMES
        for side in [joint.partition("_")[0]]
    ]  # fmt: skip
    found = recognise(names, SMPL_PARENTS)
    for side in ("left", "right"):
        for limb in forms:
            assert found[f"{side}_{limb}"] == INDEX[f"{side}_{limb}"]


def test_a_skeleton_without_arms_is_refused_by_name():
    names = [name.replace("ForeArm", "Wing") for name in MIXAMO]
    with pytest.raises(ArtifactError, match="no joint for left_elbow, right_elbow; it has Hips"):
        recognise(names, SMPL_PARENTS)


def test_a_torn_skeleton_is_refused():
    with pytest.raises(ArtifactError, match="LeftLeg does not hang on Hips"):
        recognise(MIXAMO, tuple(-1 if j == 4 else p for j, p in enumerate(SMPL_PARENTS)))
    parents = tuple(0 if j in (12, 13, 14) else p for j, p in enumerate(SMPL_PARENTS))
    with pytest.raises(ArtifactError, match="must hang on one chest above the pelvis"):
        recognise(MIXAMO, parents)


@pytest.mark.parametrize("name", ["rokoko_jesse_dance.bvh", "cmu_01_01_fairmotion.bvh"])
def test_published_dances_keep_their_limbs_directions(body, name):
    if not (MOCAP / name).is_file():
        pytest.skip(f"no {name} in {MOCAP}; set MOCAP_ROOT")
    motion = read_bvh(MOCAP / name)
    made = retarget(motion, body, torch.zeros(2))
    got = posed_joints(body, torch.zeros(2), made.global_orient, made.body_pose, made.transl)
    rig = recognise(motion.names, motion.parents)
    want = bones(world_positions(motion), LIMBS, rig)
    assert angles_between(bones(got.double(), LIMBS, INDEX), want).mean() < 0.1
    assert got[..., 1].mean(0)[INDEX["head"]] > got[..., 1].mean(0)[INDEX["left_ankle"]] + 0.8
