import dataclasses

import pytest
import torch

from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.geometry.rotations import (
    axis_angle_to_quat,
    quat_conjugate,
    quat_multiply,
    quat_to_axis_angle,
)
from deblur_avatar.motion.kinds import trajectory_from_artifact
from deblur_avatar.motion.pose_network import (
    NetworkMotion,
    NetworkParams,
    PoseNetwork,
    PoseNetworkParams,
)
from tests.randomness import seeded

JOINTS = 24


def network(hidden=(8, 8), seed=0):
    return PoseNetwork(JOINTS, hidden, seeded(seed))


def learned(seed=1, hidden=(8, 8)):
    """A network that has left its start, in double precision."""
    corrects = network(hidden).double()
    generator = seeded(seed)
    with torch.no_grad():
        for value in corrects.parameters():
            value.add_(0.2 * torch.randn(value.shape, generator=generator, dtype=value.dtype))
    return corrects


def some_poses(*batch, seed=2):
    vectors = torch.randn(*batch, JOINTS, 3, generator=seeded(seed), dtype=torch.float64)
    return axis_angle_to_quat(0.5 * vectors)


def params(hidden=(8,)):
    section = PoseNetworkParams(hidden=hidden, rate=1e-3)
    return NetworkParams(kind="network", pose_network=section)


@pytest.fixture
def moving(make_observations):
    """A motion whose network has learned something, and what it was made for."""
    seen = make_observations(frames=4)
    motion = NetworkMotion.create(seen, params(), seeded())
    with torch.no_grad():
        for value in motion.parameters():
            value.add_(0.1 * torch.randn(value.shape, generator=seeded(3)))
    return motion, seen


def test_at_first_nothing_is_corrected_to_speak_of():
    quats = some_poses(5)
    turned = network().double()(quats)
    angles = quat_to_axis_angle(quat_multiply(quat_conjugate(quats), turned)).norm(dim=-1)
    assert 0 < angles[:, 1:].max() < 1e-4


def test_each_joint_turns_by_what_the_layers_say_and_the_root_by_nothing():
    corrects, quats = learned(), some_poses()
    first, second, last = corrects.layers
    value = quat_to_axis_angle(quats[1:]).flatten()
    for layer in (first, second):
        value = layer.weight @ value + layer.bias
        value = torch.where(value > 0, value, 0.01 * value)
    turns = axis_angle_to_quat((last.weight @ value + last.bias).reshape(-1, 3))
    expected = torch.stack(
        [quats[0], *(quat_multiply(q, turn) for q, turn in zip(quats[1:], turns, strict=True))]
    )
    torch.testing.assert_close(corrects(quats), expected)
    assert torch.equal(corrects(quats)[0], quats[0])


def test_each_pose_of_a_batch_is_corrected_for_itself():
    corrects, quats = learned(), some_poses(2, 3)
    each = [[corrects(pose) for pose in row] for row in quats]
    torch.testing.assert_close(corrects(quats), torch.stack([torch.stack(row) for row in each]))


def test_where_the_root_turns_to_changes_no_correction():
    corrects, quats = learned(), some_poses()
    turned = quats.clone()
    turned[0] = some_poses(seed=5)[0]
    assert torch.equal(corrects(turned)[1:], corrects(quats)[1:])


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_in_the_rest_pose_gradients_are_finite_and_something_is_learned(dtype):
    corrects = network().to(dtype)
    rest = torch.zeros(JOINTS, 3, dtype=dtype, requires_grad=True)
    quats = corrects(axis_angle_to_quat(rest))
    assert quats.dtype == dtype
    quats[:, 1:].sum().backward()
    gradients = [value.grad for value in corrects.parameters()]
    assert all(torch.isfinite(gradient).all() for gradient in [*gradients, rest.grad])
    assert corrects.layers[-1].bias.grad.abs().min() > 0


def test_gradients_are_those_of_finite_differences():
    corrects, quats = learned(hidden=(4,)), some_poses()
    vectors = quat_to_axis_angle(quats).requires_grad_()
    names, values = zip(*corrects.named_parameters(), strict=True)

    def output(vectors, *values):
        state = dict(zip(names, values, strict=True))
        return torch.func.functional_call(corrects, state, (axis_angle_to_quat(vectors),))

    assert torch.autograd.gradcheck(output, (vectors, *values), fast_mode=True)


def test_a_generator_alone_decides_the_first_weights():
    first = network().state_dict()
    torch.manual_seed(7)
    again, other = network().state_dict(), network(seed=1).state_dict()
    assert all(torch.equal(first[name], again[name]) for name in first)
    weights = [name for name in first if name.endswith("weight")]
    assert not any(torch.equal(first[name], other[name]) for name in weights)


@pytest.mark.parametrize("hidden", [(), (5,), (3,) * 11])
def test_a_saved_networks_shape_is_found_in_its_tensors(hidden):
    saved = {f"pose_network.{name}": value for name, value in network(hidden).state_dict().items()}
    backwards = dict(sorted(saved.items(), reverse=True))
    again = PoseNetwork.saved_in(backwards, "pose_network")
    assert {f"pose_network.{name}": value.shape for name, value in again.state_dict().items()} == {
        name: value.shape for name, value in saved.items()
    }
    assert PoseNetwork.saved_in(saved, "other") is None


def test_a_frame_has_one_corrected_pose_and_stands_where_it_was_given(moving):
    motion, seen = moving
    instants = motion.at(2, torch.tensor([0.0, 0.3, 1.0]))
    assert torch.equal(instants.quats, instants.centre_quats.expand(3, -1, -1))
    given = axis_angle_to_quat(seen.poses.axis_angle[2])
    assert torch.equal(instants.centre_quats, motion.pose_network(given))
    assert torch.equal(instants.centre_quats[0], given[0])
    assert (instants.centre_quats[1:] - given[1:]).abs().max() > 1e-2
    assert torch.equal(instants.transl, seen.poses.transl[2].expand(3, -1))


def test_a_frame_that_was_not_fitted_is_corrected_as_one_in_the_same_pose(make_observations):
    seen = make_observations(frames=4)
    pose = seen.poses.body_pose.clone()
    pose[3] = pose[0]
    alike = dataclasses.replace(seen, poses=dataclasses.replace(seen.poses, body_pose=pose))
    assert 3 in alike.validation
    motion = NetworkMotion.create(alike, params(), seeded())
    assert motion.knows_unfitted
    pull = motion(0).centre_quats[16].sum()
    pull.backward()
    with torch.no_grad():
        for value in motion.parameters():
            value.sub_(0.3 * value.grad)
    assert torch.equal(motion(3).centre_quats, motion(0).centre_quats)
    assert (motion(3).centre_quats[16] - axis_angle_to_quat(pose[3])[15]).abs().max() > 1e-2


def test_a_saved_motion_keeps_its_network_and_what_it_was_given(moving, tmp_path):
    motion, seen = moving
    motion.to_artifact(seen.poses.betas, seen.timestamps).save(tmp_path / "motion")
    saved = Motion.load(tmp_path / "motion")
    again = trajectory_from_artifact(saved)
    assert type(again) is NetworkMotion
    state = motion.state_dict()
    assert again.state_dict().keys() == state.keys() == saved.parameters.keys()
    assert all(torch.equal(value, state[name]) for name, value in again.state_dict().items())
    assert torch.equal(again(1).quats, motion(1).quats)


def test_its_network_learns_at_the_networks_rate(moving):
    motion, _ = moving
    assert params().learning_rates() == {"pose_network": 1e-3}
    named = motion.parameter_groups()["pose_network"]
    assert [name for name, _ in named] == [name for name, _ in motion.named_parameters()]


def test_a_correction_that_every_frame_needs_is_learned(make_observations):
    seen = make_observations(frames=4)
    motion = NetworkMotion.create(seen, params((16,)), seeded())
    turn = torch.zeros(JOINTS, 3)
    turn[4, 0], turn[16, 2] = 0.2, -0.3
    given = axis_angle_to_quat(seen.poses.axis_angle)
    truth = quat_multiply(given, axis_angle_to_quat(turn).expand_as(given))
    optimizer = torch.optim.Adam(motion.parameters(), lr=5e-3)

    def apart():
        quats = torch.stack([motion(frame).centre_quats for frame in range(4)])
        return quat_to_axis_angle(quat_multiply(quat_conjugate(quats), truth)).square().sum()

    first = float(apart().detach())
    for _ in range(200):
        optimizer.zero_grad()
        apart().backward()
        optimizer.step()
    assert float(apart().detach()) < 1e-3 * first
