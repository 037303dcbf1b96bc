import dataclasses

import torch

from deblur_avatar.artifacts.body import Body
from deblur_avatar.bodies.triangle_joints import triangle_joints


def test_a_triangle_follows_the_strongest_joint_of_its_first_corner(body: Body):
    first, second, third = body.faces[5].tolist()
    weights = torch.full_like(body.lbs_weights, 0.0)
    weights[:, 0] = 1.0
    for corner, joint in ((first, 18), (second, 4), (third, 5)):
        weights[corner] = 0.0
        weights[corner, [joint, 7]] = torch.tensor([0.6, 0.4])
    joints = triangle_joints(dataclasses.replace(body, lbs_weights=weights))
    assert joints.shape == (len(body.faces),)
    assert joints[5] == 18
    elsewhere = ~torch.isin(body.faces[:, 0], torch.tensor([first, second, third]))
    assert (joints[elsewhere] == 0).all()
