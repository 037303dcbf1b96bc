import pytest
import torch

from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.motion.cubic import CubicMotion
from deblur_avatar.motion.kinds import KINDS, trajectory_from_artifact
from deblur_avatar.motion.learned import LearnedMotion
from deblur_avatar.motion.pair import PairMotion
from deblur_avatar.motion.per_frame import PerFrameTrajectory
from deblur_avatar.motion.released import ReleasedMotion
from deblur_avatar.motion.trajectory import instants

U = instants(5, "endpoints")
PER_FRAME = {name: kind for name, kind in KINDS.items() if issubclass(kind, PerFrameTrajectory)}


@pytest.fixture
def poses(swinging):
    return swinging(4, 10.0)


def made(kind, poses, noise=0.05):
    return kind(poses, U, noise, torch.Generator().manual_seed(0))


@pytest.mark.parametrize("kind", PER_FRAME.values(), ids=PER_FRAME)
def test_the_middle_is_the_given_pose_at_first_and_the_ends_are_apart(poses, kind):
    seen = made(kind, poses)(1)
    given = axis_angle_to_matrix(poses.axis_angle[1])
    torch.testing.assert_close(seen.centre_rotations, given, atol=2e-3, rtol=0)
    torch.testing.assert_close(seen.centre_transl, poses.transl[1])
    apart = (seen.rotations[0] - seen.rotations[-1]).abs().amax((1, 2))
    assert (apart[1:] > 1e-3).all()
    assert apart[0] == 0


@pytest.mark.parametrize("kind", PER_FRAME.values(), ids=PER_FRAME)
def test_a_saved_motion_goes_on_where_it_stopped(poses, kind):
    motion = made(kind, poses)
    with torch.no_grad():
        for value in motion.parameters():
            value.add_(0.01 * torch.randn(value.shape, generator=torch.Generator().manual_seed(1)))
    saved = motion.to_artifact(poses.betas, torch.arange(4) / 60)
    again = trajectory_from_artifact(saved)
    assert type(again) is kind
    assert torch.equal(again(2).quats, motion(2).quats)
    assert torch.equal(again(2).centre_quats, motion(2).centre_quats)


def test_knots_on_a_line_are_a_pair(poses):
    cubic, pair = made(CubicMotion, poses, noise=0.01), made(PairMotion, poses, noise=0.01)
    torch.testing.assert_close(cubic(2).rotations, pair(2).rotations, atol=1e-4, rtol=0)


def test_a_cubic_motion_can_swing_there_and_back(poses):
    motion = made(CubicMotion, poses, noise=0.0)
    with torch.no_grad():
        motion.knots[1, [0, 3], 5, 0] += 0.6
    seen = motion(1).rotations[:, 5]
    torch.testing.assert_close(seen[0], seen[-1])
    assert (seen[0] - seen[2]).abs().max() > 0.02


def test_a_motion_that_has_learned_nothing_is_a_pair_and_learns_between_the_ends(poses):
    motion, pair = made(LearnedMotion, poses), made(PairMotion, poses)
    torch.testing.assert_close(motion(0).rotations, pair(0).rotations)
    with torch.no_grad():
        motion.amount.bias.fill_(1.0)
    torch.testing.assert_close(motion(0).rotations[[0, -1]], pair(0).rotations[[0, -1]])
    assert (motion(0).rotations[2] - pair(0).rotations[2]).abs().max() > 0.05


def test_the_released_codes_sharp_pose_never_moves(poses):
    motion = made(ReleasedMotion, poses)
    seen = motion(1)
    (seen.centre_quats.sum() + seen.quats.sum()).backward()
    assert motion.start.grad.abs().sum() > 0
    assert {"given", "given_transl"} <= set(motion.state_dict())
    assert "given" not in dict(motion.named_parameters())
    torch.testing.assert_close(motion.end, made(PairMotion, poses, noise=0.0).end)
