import dataclasses

import numpy as np
import pytest
import torch

from deblur_avatar.errors import ArtifactError
from deblur_avatar.evaluation.truth_views import _extend_outside, truth_views


def test_training_frames_give_novel_views_and_held_out_frames_novel_poses(scene):
    views = truth_views(scene.observations, scene.reference)
    assert {view.position for view in views if not view.novel_pose} == {0, 1, 3, 4}
    assert {view.position for view in views if view.novel_pose} == {5, 6, 7}
    assert {view.camera for view in views} == {1, 2}
    assert len(views) == 14


def test_frames_without_a_person_or_a_blurred_counterpart_are_left_out(scene):
    weights = scene.observations.weights.clone()
    weights[3] = 0
    observations = dataclasses.replace(scene.observations, weights=weights)
    indices = scene.reference.frame_indices.clone()
    indices[0] = 99
    reference = dataclasses.replace(scene.reference, frame_indices=indices)
    found = [(view.camera, view.position) for view in truth_views(observations, reference)]
    assert not [position for _, position in found if position == 3]
    assert (1, 0) not in found
    assert (2, 0) in found


def test_the_truth_is_brought_to_the_observations_pixels(scene):
    view = truth_views(scene.observations, scene.reference)[0]
    assert view.image.shape == (24, 24, 3)
    means = scene.reference.images[0].reshape(24, 2, 24, 2, 3).double().mean((1, 3))
    assert (view.image - means).abs().max() <= 0.5
    matte = scene.reference.mattes[0].reshape(24, 2, 24, 2).double().mean((1, 3))
    assert torch.equal(view.foreground, matte.round() > 127)


def test_a_crop_cuts_the_truth_as_it_cut_the_observations(scene):
    crops = scene.observations.crops.clone()
    crops[1] = torch.tensor([10.0, 4, 24, 24])
    observations = dataclasses.replace(scene.observations, crops=crops)
    view = truth_views(observations, scene.reference)[0]
    assert torch.equal(view.image, scene.reference.images[0, 4:28, 10:34])


def test_what_the_source_knows_to_be_seen_is_taken(scene):
    seen = torch.zeros_like(scene.reference.mattes)
    seen[:, :, 24:] = 255
    reference = dataclasses.replace(scene.reference, seen=seen)
    view = truth_views(scene.observations, reference)[0]
    assert torch.equal(view.seen[:, 12:], view.foreground[:, 12:])
    assert not view.seen[:, :12].any()
    assert view.foreground[:, :12].any()


def test_without_a_source_that_knows_the_fitted_body_tells_what_was_seen(scene):
    views = truth_views(scene.observations, scene.reference)
    for view in views:
        assert not (view.seen & ~view.foreground).any()
        # Side cameras 45 degrees off share most of the surface with the one in front.
        assert 0.6 < view.seen.sum() / view.foreground.sum() < 1
    behind = scene.observations.cameras.viewmats.clone()
    behind[1] = behind[0] @ torch.diag(torch.tensor([-1.0, 1, -1, 1]))
    cameras = dataclasses.replace(scene.observations.cameras, viewmats=behind)
    from_behind = dataclasses.replace(scene.observations, cameras=cameras)
    backs = [view for view in truth_views(from_behind, scene.reference) if view.camera == 1]
    for view in backs:
        assert view.seen.sum() < 0.2 * view.foreground.sum()


def test_beside_the_body_its_nearest_pixel_decides():
    body = np.zeros((3, 8), bool)
    body[1, 2:6] = True
    seen = np.zeros((3, 8), bool)
    seen[1, 4:6] = True
    wanted = torch.zeros(3, 8, dtype=torch.bool)
    wanted[:, 4:] = True
    assert torch.equal(_extend_outside(seen, body), wanted)
    assert not _extend_outside(seen & False, body & False).any()


def test_a_reference_without_a_training_frame_is_refused(scene):
    reference = dataclasses.replace(
        scene.reference, novel_pose=torch.ones_like(scene.reference.novel_pose)
    )
    with pytest.raises(ArtifactError, match="no test view shows a training frame"):
        truth_views(scene.observations, reference)


def test_a_reference_of_other_cameras_is_refused(scene):
    reference = dataclasses.replace(
        scene.reference, camera_indices=scene.reference.camera_indices + 2
    )
    with pytest.raises(ArtifactError, match="shows camera 4, the observations know 3"):
        truth_views(scene.observations, reference)
