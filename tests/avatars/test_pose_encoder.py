import pytest
import torch

from deblur_avatar.avatars.pose_encoder import JOINT_FEATURES, PoseEncoder
from deblur_avatar.bodies.posed_body import shaped_joints, shaped_vertices
from deblur_avatar.geometry.rotations import axis_angle_to_matrix


@pytest.fixture
def encoder(body):
    torch.manual_seed(0)
    return PoseEncoder(body, torch.tensor([0.5, -0.3])).double()


def rotations_of(joints, seed=1):
    generator = torch.Generator().manual_seed(seed)
    turns = torch.randn(joints, 3, generator=generator, dtype=torch.float64)
    turns[0] = 0
    return axis_angle_to_matrix(turns)


def one_joint_after_another(encoder, rotations, parents):
    flat, rest = rotations.flatten(1), encoder.rest
    overall = encoder.overall(torch.cat([flat, rest[:, :3]], 1).flatten())
    codes = []
    for joint, parent in enumerate(parents):
        above = overall if parent < 0 else codes[parent]
        inputs = torch.cat([flat[joint], rest[joint], above])
        hidden = (inputs @ encoder.weight1[joint] + encoder.bias1[joint, 0]).relu()
        codes.append(hidden @ encoder.weight2[joint] + encoder.bias2[joint, 0])
    return torch.stack(codes)


def depth(joint, parents):
    return 0 if parents[joint] < 0 else 1 + depth(parents[joint], parents)


def test_levels_of_the_tree_give_what_a_loop_over_joints_gives(encoder, body):
    rotations = rotations_of(len(body.parents))
    codes = one_joint_after_another(encoder, rotations, body.parents)
    order = sorted(range(len(body.parents)), key=lambda joint: depth(joint, body.parents))
    encoded = encoder(rotations)
    assert encoded.shape == (encoder.size,)
    torch.testing.assert_close(encoded, codes[order].flatten())


def test_joints_are_normalised_by_the_bodys_extent_and_a_twentieth_of_it_around(encoder, body):
    betas = torch.tensor([0.5, -0.3])
    vertices, joints = shaped_vertices(body, betas), shaped_joints(body, betas)
    vertices, joints = vertices - vertices.mean(0), joints - vertices.mean(0)
    low, high = vertices.min(), vertices.max()
    padding = 0.05 * (high - low)
    share = (joints - (low - padding)) / (high - low + 2 * padding)  # 0 and 1 are the ends
    torch.testing.assert_close(encoder.rest[:, :3].float(), 2 * share - 1)


def test_bone_lengths_are_those_of_the_shaped_body(encoder, body):
    grown = 1 + 0.05 * 0.5  # beta 0
    elbow_to_wrist = (body.joints[20] - body.joints[18]).norm() * grown
    torch.testing.assert_close(encoder.rest[20, 3].float(), elbow_to_wrist)


def test_every_joint_can_be_felt(encoder, body):
    rotations = rotations_of(len(body.parents)).requires_grad_()
    encoder(rotations).square().sum().backward()
    assert (rotations.grad.flatten(1).abs().sum(1) > 0).all()


def test_the_gradient_is_that_of_differences(encoder, body):
    rotations = rotations_of(len(body.parents)).requires_grad_()

    def first_codes(value):
        return encoder(value)[: 4 * JOINT_FEATURES]

    assert torch.autograd.gradcheck(first_codes, rotations)


def test_layers_start_as_pytorch_starts_its_own(encoder):
    bound = (9 + 3 + 1 + JOINT_FEATURES) ** -0.5
    for weights in (encoder.weight1, encoder.bias1, encoder.weight2, encoder.bias2):
        assert weights.abs().max() <= bound
        assert weights.std().item() == pytest.approx(bound / 3**0.5, rel=0.1)
