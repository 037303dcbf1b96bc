import dataclasses

import pytest
import torch

from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.evaluation.comparisons import compare, pose_of_view
from deblur_avatar.evaluation.registration import Similarity, registered, seen_through, similarity
from deblur_avatar.evaluation.truth_views import truth_views
from deblur_avatar.geometry.cameras import look_at, project
from deblur_avatar.geometry.rotations import axis_angle_to_matrix

TURN = axis_angle_to_matrix(torch.tensor([0.3, -0.5, 0.2], dtype=torch.float64))
SHIFT = torch.tensor([0.1, 0.2, 3.0], dtype=torch.float64)


def points() -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    return torch.randn(24, 3, generator=generator, dtype=torch.float64)


def test_a_similarity_is_found_again():
    moved = similarity(points(), 1.3 * points() @ TURN.T + SHIFT)
    assert moved.scale == pytest.approx(1.3)
    torch.testing.assert_close(moved.turn, TURN)
    torch.testing.assert_close(moved.shift, SHIFT)


def test_a_camera_sees_the_same_through_a_similarity():
    viewmat = look_at(torch.tensor([2.0, 0.5, 9.0]), torch.zeros(3), torch.tensor([0.0, 1.0, 0.0]))
    K = torch.tensor([[300.0, 0, 100], [0, 300, 100], [0, 0, 1]]).double()
    moved = Similarity(1.3, TURN, SHIFT)
    wanted, depth = project(moved.applied(points()), K, viewmat.double())
    found, _ = project(points(), K, seen_through(viewmat.double(), moved))
    assert depth.min() > 1
    torch.testing.assert_close(found, wanted)


def test_a_mirrored_person_is_not_turned_inside_out():
    mirrored = points() * torch.tensor([-1.0, 1, 1])
    assert float(torch.linalg.det(similarity(points(), mirrored).turn)) == pytest.approx(1)


def test_a_registered_camera_sees_the_estimated_person_where_the_true_one_is(body):
    joints = len(body.parents) - 1
    true = _poses(body, torch.zeros(1, 3), torch.zeros(1, joints, 3), torch.zeros(1, 3))
    turned = _poses(
        body, torch.tensor([[0.2, 0.9, 0.1]]), torch.zeros(1, joints, 3),
        torch.tensor([[0.3, 0.1, 2.0]]),
    )  # fmt: skip
    up, middle = torch.tensor([0.0, 1.0, 0.0]), torch.zeros(3)
    viewmat = look_at(torch.tensor([2.0, 0.5, 3.0]), middle, up)
    K = torch.tensor([[300.0, 0, 100], [0, 300, 100], [0, 0, 1]])
    there = registered(viewmat, body, turned, true)
    wanted, depth = project(posed(body, true).joints[0], K, viewmat)
    found, _ = project(posed(body, turned).joints[0], K, there)
    assert depth.min() > 1
    torch.testing.assert_close(found, wanted, atol=0.01, rtol=0)


def _poses(body, orient, pose, transl):
    betas = torch.zeros(body.shape_dirs.shape[2])
    return Poses(betas=betas, global_orient=orient, body_pose=pose, transl=transl)


def test_views_of_an_estimated_world_are_compared_as_in_the_true_one(scene, painted):
    """An avatar that was fitted in a world moved and turned as a whole is as good as before."""
    observations, reference = scene.observations, scene.reference
    view = truth_views(observations, reference)[0]
    model = painted(frames=8)
    pose = pose_of_view(observations, scene.motion, view)
    before = compare(model, observations, reference, view, pose).scores["psnr"]
    stood = observations.cameras.viewmats[reference.camera_indices]
    there = dataclasses.replace(reference, viewmats=stood)
    (moved_view, *_) = truth_views(observations, there)
    away = dataclasses.replace(pose, transl=pose.transl + torch.tensor([[0.4, -0.2, 0.7]]))
    lost = compare(model, observations, reference, view, away).scores["psnr"]
    kept = compare(model, observations, there, moved_view, away).scores["psnr"]
    assert lost < before - 3
    # The motion's samples lie up to an eighth of a frame from the middle.
    assert kept == pytest.approx(before, abs=1.5)
