import dataclasses

import pytest
import torch

from deblur_avatar.body_estimation.occluded_surface import occluded_fraction


def turned(poses, degrees: list[float]):
    """The same person, standing, turned about the vertical."""
    count = len(degrees)
    upright = torch.zeros(count, 3)
    upright[:, 1] = torch.deg2rad(torch.tensor(degrees))
    still = poses.at([0] * count)
    return dataclasses.replace(
        still, global_orient=upright, body_pose=torch.zeros_like(still.body_pose)
    )


def test_one_camera_sees_less_than_half_of_someone_who_stands_still(body, swinging, front):
    share = occluded_fraction(body, turned(swinging(2, 0.0), [0.0]), front, 0)
    assert 0.5 < share < 0.7


def test_turning_round_shows_nearly_everything(body, swinging, front):
    around = turned(swinging(2, 0.0), [45.0 * step for step in range(8)])
    half = turned(swinging(2, 0.0), [0.0, 180.0])
    shares = [occluded_fraction(body, poses, front, 0) for poses in (around, half)]
    assert shares[0] < shares[1] < 0.45
    assert shares[0] < 0.35


def test_who_is_out_of_the_picture_is_not_seen(body, swinging, front):
    poses = turned(swinging(2, 0.0), [0.0])
    beside = dataclasses.replace(poses, transl=torch.tensor([[50.0, 0.0, 0.0]]))
    assert occluded_fraction(body, beside, front, 0) == 1.0


def test_where_camera_and_person_stand_together_changes_nothing(body, swinging, front):
    poses = turned(swinging(2, 0.0), [30.0])
    moved = dataclasses.replace(poses, transl=poses.transl + torch.tensor([1.0, 2.0, 3.0]))
    shift = torch.eye(4)
    shift[:3, 3] = -torch.tensor([1.0, 2.0, 3.0])
    along = dataclasses.replace(front, viewmats=front.viewmats @ shift)
    share = occluded_fraction(body, poses, front, 0)
    assert occluded_fraction(body, moved, along, 0) == pytest.approx(share, abs=2e-3)
