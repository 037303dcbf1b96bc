import time

import torch
import trimesh

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES, SMPL_PARENTS
from deblur_avatar.bodies.capsule import capsule_body


def test_it_has_smpls_joints_and_a_few_hundred_vertices():
    body = capsule_body()
    assert body.joint_names == SMPL_JOINT_NAMES
    assert body.parents == SMPL_PARENTS
    assert 300 < len(body.vertices) < 1500


def test_it_is_the_same_every_time_and_takes_milliseconds():
    first = capsule_body()
    begin = time.perf_counter()
    second = capsule_body()
    assert time.perf_counter() - begin < 1
    assert torch.equal(first.vertices, second.vertices)
    assert torch.equal(first.lbs_weights, second.lbs_weights)


def test_it_stands_upright_in_a_t_pose_with_the_left_hand_towards_plus_x():
    body = capsule_body()
    place = dict(zip(body.joint_names, body.joints, strict=True))
    torch.testing.assert_close(place["pelvis"], torch.zeros(3))
    assert place["head"][1] > 0.5
    assert place["left_ankle"][1] < -0.8
    assert place["left_wrist"][0] > 0.6
    assert place["left_foot"][2] > place["left_ankle"][2]  # toes point forward
    assert abs(place["left_wrist"][1] - place["left_shoulder"][1]) < 0.01


def test_its_right_side_mirrors_its_left():
    body = capsule_body()
    mirror = torch.tensor([-1.0, 1.0, 1.0])
    for index, name in enumerate(SMPL_JOINT_NAMES):
        if name.startswith("left_"):
            other = SMPL_JOINT_NAMES.index(name.replace("left_", "right_"))
            torch.testing.assert_close(body.joints[index] * mirror, body.joints[other])
    low, high = body.vertices[:, 0].min(), body.vertices[:, 0].max()
    torch.testing.assert_close(-low, high)


def test_every_capsule_is_closed_and_faces_outwards():
    body = capsule_body()
    mesh = trimesh.Trimesh(body.vertices.numpy(), body.faces.numpy(), process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert all(part.volume > 0 for part in mesh.split())


def test_every_joint_moves_something():
    body = capsule_body()
    moved = body.lbs_weights.max(0).values
    assert (moved > 0.2).all()


def test_the_first_shape_number_scales_and_the_second_thickens():
    body = capsule_body()
    torch.testing.assert_close(body.shape_dirs[..., 0], 0.05 * body.vertices)
    torch.testing.assert_close(body.joint_dirs[..., 1], torch.zeros_like(body.joints))
    thick = body.vertices + 2 * body.shape_dirs[..., 1]
    mesh = trimesh.Trimesh(body.vertices.numpy(), body.faces.numpy(), process=False)
    assert trimesh.Trimesh(thick.numpy(), body.faces.numpy(), process=False).volume > mesh.volume
