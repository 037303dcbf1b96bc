import dataclasses

import pytest
import torch

from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.errors import ArtifactError
from deblur_avatar.geometry.rotations import (
    axis_angle_to_matrix,
    axis_angle_to_quat,
    matrix_to_axis_angle,
)
from deblur_avatar.motion.frame import FixedMotion, FrameMotion
from deblur_avatar.motion.kinds import trajectory_from_artifact
from deblur_avatar.motion.pair import PairMotion
from deblur_avatar.motion.trajectory import instants
from tests.randomness import seeded

TIMES = torch.arange(4) / 60


@pytest.fixture
def poses(swinging):
    given = swinging(4, 10.0)
    return dataclasses.replace(
        given,
        global_orient=0.3 * torch.randn(4, 3, generator=seeded(5)),
        body_pose=given.body_pose + 0.2 * torch.randn(4, 23, 3, generator=seeded(6)),
    )


def pair(poses, count=5, noise=0.05, quadrature="endpoints"):
    return PairMotion(poses, instants(count, quadrature), noise, seeded())


def test_instants_of_the_paper_include_both_ends():
    torch.testing.assert_close(instants(5, "endpoints"), torch.tensor([0, 0.25, 0.5, 0.75, 1]))


def test_midpoints_are_the_middles_of_equal_parts():
    torch.testing.assert_close(instants(4, "midpoints"), torch.tensor([1.0, 3, 5, 7]) / 8)


@pytest.mark.parametrize("quadrature", ["endpoints", "midpoints"])
@pytest.mark.parametrize("count", [1, 2, 5, 8])
def test_instants_are_as_early_as_they_are_late(count, quadrature):
    u = instants(count, quadrature)
    assert len(u) == count
    torch.testing.assert_close(u.flip(0), 1 - u)


def test_endpoints_make_a_motion_look_longer_than_it_is_and_midpoints_shorter_by_less():
    # The variance of positions seen, for a unit motion, is 1 / 12 when light is collected evenly.
    spread = {
        name: instants(5, name).var(correction=0).item() for name in ("endpoints", "midpoints")
    }
    assert spread["endpoints"] == pytest.approx(6 / 4 / 12)
    assert spread["midpoints"] == pytest.approx((1 - 1 / 25) / 12)


@pytest.mark.parametrize("kind", [FixedMotion, FrameMotion])
def test_a_frame_motion_stands_still_in_the_given_pose(poses, kind):
    motion = kind(poses)
    seen = motion(2)
    torch.testing.assert_close(seen.rotations[0], axis_angle_to_matrix(poses.axis_angle[2]))
    torch.testing.assert_close(seen.centre_rotations, axis_angle_to_matrix(poses.axis_angle[2]))
    torch.testing.assert_close(seen.transl, poses.transl[2:3])
    assert all(value.requires_grad == (kind is FrameMotion) for value in motion.parameters())


def test_a_pair_turns_from_its_start_to_its_end_and_moves_straight(poses):
    motion = pair(poses)
    with torch.no_grad():
        motion.end_transl[1] += torch.tensor([0.1, 0.2, 0.3])
    seen = motion(1)
    ends = axis_angle_to_quat(torch.stack([motion.start[1], motion.end[1]]))
    # Up to the sign of a quaternion.
    cosines = (seen.quats[[0, -1]] * ends).sum(-1).abs()
    torch.testing.assert_close(cosines, torch.ones(2, 24))
    expected = poses.transl[1] + instants(5, "endpoints")[:, None] * torch.tensor([0.1, 0.2, 0.3])
    torch.testing.assert_close(seen.transl, expected)


def test_a_pair_turns_at_constant_speed(poses):
    seen = pair(poses, count=5, noise=0.5)(0)
    steps = seen.rotations[:-1].mT @ seen.rotations[1:]
    turned = matrix_to_axis_angle(steps)
    torch.testing.assert_close(turned, turned[:1].expand_as(turned), atol=1e-5, rtol=1e-3)


def test_the_centre_of_a_pair_is_half_way_whatever_its_instants(poses):
    odd, even = pair(poses, 5), pair(poses, 2, quadrature="midpoints")
    assert torch.equal(odd(1).centre_quats, odd(1).quats[2])
    torch.testing.assert_close(even(1).centre_quats, odd(1).centre_quats)


def test_noise_parts_the_limbs_leaves_the_root_and_keeps_the_middle(poses):
    motion = pair(poses, noise=0.05)
    apart = (motion.start - motion.end).detach()
    assert apart[:, 1:].std().item() == pytest.approx(0.05, rel=0.1)
    assert apart[:, 0].abs().max() == 0
    assert torch.equal(motion.start_transl, motion.end_transl)
    given = torch.cat([poses.global_orient[:, None], poses.body_pose], 1)
    torch.testing.assert_close((motion.start + motion.end) / 2, given)


def test_without_noise_a_pair_is_a_frame_motion_that_has_been_copied(poses):
    still, frame = pair(poses, noise=0.0)(1), FrameMotion(poses)(1)
    torch.testing.assert_close(still.rotations, frame.rotations.expand(5, 24, 3, 3))
    torch.testing.assert_close(still.transl, frame.transl.expand(5, 3))


def gradients(motion, shared):
    """Of a picture that depends on all instants alike, as an exposure does."""
    seen = motion(1)
    if shared:  # every instant pulls in the same direction, as where all renders are equal
        pull = torch.randn(24, 3, 3, generator=seeded(1)).expand(5, 24, 3, 3)
    else:
        pull = torch.randn(5, 24, 3, 3, generator=seeded(1))
    (pull * seen.rotations).sum().backward()
    return motion.start.grad[1], motion.end.grad[1]


def test_equal_ends_are_a_saddle_on_which_start_and_end_are_pulled_alike(poses):
    start, end = gradients(pair(poses, noise=0.0), shared=True)
    assert start.abs().max() > 0.1
    torch.testing.assert_close(start, end, atol=1e-5, rtol=1e-5)


def test_noise_makes_the_pulls_differ(poses):
    start, end = gradients(pair(poses, noise=0.05), shared=True)
    assert (start - end)[1:].abs().max() > 1e-3


def test_gradients_of_equal_ends_are_finite_and_those_of_other_frames_zero(poses):
    motion = pair(poses, noise=0.0)
    gradients(motion, shared=False)
    assert torch.isfinite(motion.start.grad).all()
    assert motion.start.grad[[0, 2, 3]].abs().max() == 0


@pytest.mark.parametrize("kind", ["fixed", "frame", "pair"])
def test_a_motion_saved_and_loaded_goes_on_where_it_was(poses, kind, tmp_path):
    if kind == "pair":
        motion = pair(poses, 3, quadrature="midpoints")
    else:
        motion = FrameMotion(poses) if kind == "frame" else FixedMotion(poses)
    motion.to_artifact(poses.betas, TIMES).save(tmp_path / "motion")
    loaded = Motion.load(tmp_path / "motion")
    again = trajectory_from_artifact(loaded)
    assert again.kind == kind
    for frame in range(4):
        assert torch.equal(again(frame).quats, motion(frame).quats)
        assert torch.equal(again(frame).transl, motion(frame).transl)
    trained = [name for name, value in again.named_parameters() if value.requires_grad]
    assert trained == [name for name, value in motion.named_parameters() if value.requires_grad]


def test_an_artifact_says_where_the_body_was_at_every_instant(poses):
    motion = pair(poses)
    artifact = motion.to_artifact(poses.betas, TIMES)
    axis_angle = torch.cat([artifact.global_orient[:, :, None], artifact.body_pose], 2)
    assert axis_angle.shape == (4, 5, 24, 3)
    torch.testing.assert_close(axis_angle[3, 0], motion.start[3].detach(), atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(axis_angle[3, 4], motion.end[3].detach(), atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(
        axis_angle_to_matrix(artifact.centre.axis_angle[3]), motion(3).centre_rotations
    )
    torch.testing.assert_close(artifact.transl[2], poses.transl[2].expand(5, 3))


def test_an_artifact_does_not_change_when_fitting_goes_on(poses):
    motion = pair(poses)
    artifact = motion.to_artifact(poses.betas, TIMES)
    before = artifact.parameters["start"].clone()
    with torch.no_grad():
        motion.start.add_(1.0)
        trajectory_from_artifact(artifact).start.add_(1.0)
    assert torch.equal(artifact.parameters["start"], before)


def test_a_kind_of_motion_from_another_version_is_refused(poses):
    artifact = pair(poses).to_artifact(poses.betas, TIMES)
    with pytest.raises(ArtifactError, match="no motion of kind 'sixth' is known; run `dvc repro`"):
        trajectory_from_artifact(dataclasses.replace(artifact, kind="sixth"))
