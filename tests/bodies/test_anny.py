"""Anny takes a minute to build, so what needs it runs when asked for.

Set DEBLUR_AVATAR_SLOW_TESTS=1 for the comparison with Anny itself; the baked body is looked at
where `data/body/anny` is at hand (`dvc repro body@anny`).
"""

import os
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from deblur_avatar.artifacts.body import (
    SMPL_JOINT_NAMES,
    SMPL_PARENTS,
    Body,
)
from deblur_avatar.bodies.anny import (
    MIXAMO_NAMES,
    OURS_FROM_ANNY,
    Rig,
    load_model,
    phenotype_coefficients,
    population_coefficients,
    principal_components,
    read_rig,
    t_pose_rotations,
    t_posed,
)
from deblur_avatar.bodies.capsule import capsule_body
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.geometry.skinning import forward_kinematics, skin_points

BAKED = Path(__file__).resolve().parents[2] / "data" / "body" / "anny"
LEFT_ARM = [SMPL_JOINT_NAMES.index(f"left_{name}") for name in ("shoulder", "elbow", "wrist")]
A_POSE = torch.tensor([0.0, 0.0, -0.7], dtype=torch.float64)


@pytest.fixture(scope="module")
def a_posed() -> Rig:
    """The capsule body with both arms down, as Anny stands, with two shape coefficients."""
    body = capsule_body()
    turns = torch.zeros(24, 3, dtype=torch.float64)
    turns[16], turns[17] = A_POSE, -A_POSE
    transforms = forward_kinematics(
        axis_angle_to_matrix(turns), body.joints.double(), torch.ones(3).double(), SMPL_PARENTS
    )
    joints = body.joints.double()
    placed = (transforms[:, :3, :3] @ joints[..., None])[..., 0] + transforms[:, :3, 3]
    vertices = skin_points(body.vertices.double(), body.lbs_weights.double(), transforms)
    grow, shift = 0.1, torch.tensor([0.3, 0.2, 0.1], dtype=torch.float64)
    return Rig(
        vertices=vertices,
        vertex_dirs=torch.stack([grow * vertices, shift.expand_as(vertices)]),
        joints=placed,
        joint_dirs=torch.stack([grow * placed, shift.expand_as(placed)]),
        lbs_weights=body.lbs_weights.double(),
        faces=body.faces,
        uvs=torch.zeros(len(body.faces), 3, 2, dtype=torch.float64),
    )


def test_the_t_pose_lays_the_arms_along_x(a_posed: Rig):
    coefficients = torch.zeros(1, 2, dtype=torch.float64)
    joints = t_posed(a_posed, coefficients)[0, len(a_posed.vertices) :]
    torch.testing.assert_close(joints[0], torch.zeros(3).double())
    for start, end in zip(LEFT_ARM, LEFT_ARM[1:], strict=False):
        bone = joints[end] - joints[start]
        torch.testing.assert_close(bone / bone.norm(), torch.tensor([1.0, 0, 0]).double())


def test_the_t_pose_keeps_the_spine_the_thighs_and_the_feet(a_posed: Rig):
    rotations = t_pose_rotations(a_posed.joints)
    kept = [SMPL_JOINT_NAMES.index(name) for name in ("pelvis", "spine2", "left_hip", "head")]
    torch.testing.assert_close(rotations[kept], torch.eye(3).double().expand(len(kept), 3, 3))
    world = forward_kinematics(rotations, a_posed.joints, torch.zeros(3).double(), SMPL_PARENTS)[
        :, :3, :3
    ]
    torch.testing.assert_close(world[7], torch.eye(3).double())  # the left foot


def test_the_t_pose_takes_the_hands_along(a_posed: Rig):
    hands = t_pose_rotations(a_posed.joints)[22:]
    torch.testing.assert_close(hands, torch.eye(3).double().expand(2, 3, 3))


def test_bones_keep_their_lengths_in_the_t_pose(a_posed: Rig):
    joints = t_posed(a_posed, torch.zeros(1, 2).double())[0, len(a_posed.vertices) :]
    above = list(SMPL_PARENTS[1:])
    before = (a_posed.joints[1:] - a_posed.joints[above]).norm(dim=1)
    torch.testing.assert_close((joints[1:] - joints[above]).norm(dim=1), before)


def test_the_t_posed_body_is_linear_in_the_coefficients(a_posed: Rig):
    points = torch.tensor([[0.0, 0], [1, 0], [0, 1], [2, -3]], dtype=torch.float64)
    rest, first, second, both = t_posed(a_posed, points)
    torch.testing.assert_close(both, rest + 2 * (first - rest) - 3 * (second - rest))
    # A shift of the whole body is undone: the pelvis stays at the origin.
    torch.testing.assert_close(second, rest)


def test_principal_components_count_standard_deviations():
    generator = torch.Generator().manual_seed(0)
    truth = torch.linalg.qr(torch.randn(30, 2, generator=generator).double())[0]
    scores = torch.randn(200, 2, generator=generator).double() * torch.tensor([3.0, 0.5]).double()
    samples = (scores @ truth.T).reshape(-1, 10, 3) + 7
    mean, dirs = principal_components(samples, 10, 2)
    torch.testing.assert_close(mean, torch.full_like(mean, 7), atol=0.2, rtol=0)
    lengths = dirs.reshape(30, 2).norm(dim=0)
    torch.testing.assert_close(lengths, torch.tensor([3.0, 0.5]).double(), atol=0.2, rtol=0)
    assert (dirs.reshape(30, 2).T @ truth)[0, 0].abs() > 2.7


def test_only_the_leading_points_decide_the_components():
    samples = torch.zeros(50, 2, 3, dtype=torch.float64)
    swing = torch.linspace(-1, 1, 50).double()
    samples[:, 0, 0] = swing
    samples[:, 1, 1] = 100 * swing.square()  # a joint that runs wild
    _, dirs = principal_components(samples, 1, 1)
    spread = swing.square().mean().sqrt()
    torch.testing.assert_close(dirs[0, :, 0], torch.tensor([1.0, 0, 0]).double() * spread)


def fake_model() -> SimpleNamespace:
    """What `read_rig` looks at, with a finger and a thumb that have weights of their own."""
    labels = [*MIXAMO_NAMES, "LeftHandThumb2", "LeftHandPinky3", "RightHandIndex1"]
    count = len(labels)
    return SimpleNamespace(
        bone_labels=[f"mixamorig:{label}" for label in labels],
        template_vertices=torch.eye(3).double().repeat(count // 3, 1)[:count],
        dense_vertex_bone_weights=torch.eye(count).double(),
        blendshapes=torch.zeros(1, count, 3).double(),
        template_bone_heads=torch.arange(3 * count).double().reshape(count, 3),
        bone_heads_blendshapes=torch.zeros(1, count, 3).double(),
        faces=torch.zeros(2, 3, dtype=torch.int64),
        texture_coordinates=torch.zeros(4, 2).double(),
        face_texture_coordinate_indices=torch.zeros(2, 3, dtype=torch.int64),
    )


def test_thumbs_join_the_wrist_and_fingers_the_hand():
    rig = read_rig(fake_model())
    thumb, pinky, index = rig.lbs_weights[24:]
    assert thumb[SMPL_JOINT_NAMES.index("left_wrist")] == 1
    assert pinky[SMPL_JOINT_NAMES.index("left_hand")] == 1
    assert index[SMPL_JOINT_NAMES.index("right_hand")] == 1
    torch.testing.assert_close(rig.lbs_weights[:24], torch.eye(24).double())


def test_annys_axes_become_ours():
    rig = read_rig(fake_model())
    left, back, up = rig.vertices[:3]  # Anny's X, Y, Z
    assert left.tolist() == [1, 0, 0]
    assert back.tolist() == [0, 0, -1]  # Anny faces -Y, we face +Z
    assert up.tolist() == [0, 1, 0]
    assert torch.linalg.det(OURS_FROM_ANNY) == 1


@pytest.fixture(scope="module")
def baked() -> Body:
    if not BAKED.is_dir():
        pytest.skip("no baked body in data/body/anny; `dvc repro body@anny` makes it")
    return Body.load(BAKED)


def test_the_baked_body_stands_as_smpl_does(baked: Body):
    place = dict(zip(baked.joint_names, baked.joints, strict=True))
    torch.testing.assert_close(place["pelvis"], torch.zeros(3), atol=1e-6, rtol=0)
    for side, sign in (("left", 1), ("right", -1)):
        arm = place[f"{side}_wrist"] - place[f"{side}_shoulder"]
        assert arm[0] * sign / arm.norm() > 0.9999
        foot = place[f"{side}_foot"] - place[f"{side}_ankle"]
        assert foot[2] / foot.norm() > 0.9
    height = baked.vertices[:, 1].max() - baked.vertices[:, 1].min()
    assert 1.6 < height < 1.85


def test_the_baked_palms_face_down(baked: Body):
    hand = SMPL_JOINT_NAMES.index("left_hand")
    fingers = baked.vertices[baked.lbs_weights[:, hand] > 0.9]
    spread = fingers.max(0).values - fingers.min(0).values
    assert spread[1] < 0.8 * spread[2]  # flat, not on edge


def test_the_baked_body_has_textures_and_its_first_number_is_the_largest(baked: Body):
    assert baked.uvs is not None
    assert 0 <= baked.uvs.min() <= baked.uvs.max() <= 1
    sizes = baked.shape_dirs.square().mean((0, 1))
    assert sizes.argmax() == 0
    assert "CC0" in baked.licence


@pytest.mark.skipif(
    os.environ.get("DEBLUR_AVATAR_SLOW_TESTS") != "1",
    reason="builds Anny, which takes a minute; set DEBLUR_AVATAR_SLOW_TESTS=1",
)
@pytest.mark.timeout(600)
def test_our_skinning_of_annys_rig_is_annys_own():
    model = load_model()
    generator = torch.Generator().manual_seed(0)
    phenotypes = torch.rand(1, len(model.phenotype_labels), generator=generator).double()
    rig, coefficients = read_rig(model), phenotype_coefficients(model, phenotypes)[0]
    turns = 0.6 * torch.randn(24, 3, generator=generator).double()
    turns[22:] = 0  # fingers are one with the hand in ours alone
    rotations = axis_angle_to_matrix(turns)
    labels = [label.removeprefix("mixamorig:") for label in model.bone_labels]
    theirs = torch.eye(4).double().repeat(1, len(labels), 1, 1)
    anny_from_ours = OURS_FROM_ANNY.T
    for name, rotation in zip(MIXAMO_NAMES, rotations, strict=True):
        theirs[0, labels.index(name), :3, :3] = anny_from_ours @ rotation @ OURS_FROM_ANNY
    output = model(pose_parameters=theirs, phenotype_kwargs=phenotypes)
    joints = rig.joints + torch.einsum("m,mjc->jc", coefficients, rig.joint_dirs)
    vertices = rig.vertices + torch.einsum("m,mpc->pc", coefficients, rig.vertex_dirs)
    transforms = forward_kinematics(rotations, joints, -joints[0], SMPL_PARENTS)
    ours = skin_points(vertices, rig.lbs_weights, transforms)
    torch.testing.assert_close(ours, output["vertices"][0] @ anny_from_ours, atol=1e-9, rtol=0)

    # The population's heights are adults'.
    people = t_posed(rig, population_coefficients(model)[:64])[:, : len(rig.vertices), 1]
    heights = people.max(1).values - people.min(1).values
    assert 1.6 < heights.mean() < 1.85
    assert 0.05 < heights.std() < 0.2
