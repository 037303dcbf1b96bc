import math

import pytest
import torch

from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.geometry.rotations import axis_angle_to_matrix, quat_to_matrix
from deblur_avatar.motion.clip import ClipMotion
from deblur_avatar.motion.kinds import trajectory_from_artifact
from deblur_avatar.motion.trajectory import LEVER, instants


def circling(frames: int) -> Poses:
    """A body that turns all the way round at constant speed while it drifts."""
    turn = torch.linspace(0, 2 * torch.pi, frames)
    axis_angle = torch.zeros(frames, 24, 3)
    axis_angle[:, 0, 1] = torch.remainder(turn + torch.pi, 2 * torch.pi) - torch.pi
    return Poses(
        betas=torch.zeros(2),
        global_orient=axis_angle[:, 0],
        body_pose=axis_angle[:, 1:],
        transl=torch.linspace(0, 1, frames)[:, None].repeat(1, 3),
    )


def clip_motion(poses: Poses, exposure: float, knot_frames: float = 2.0) -> ClipMotion:
    timestamps = torch.arange(len(poses.transl)) / 60
    return ClipMotion.near(
        poses, instants(5, "midpoints"), timestamps, exposure, knot_frames / 60, 0.0
    )


def test_a_clip_trajectory_passes_near_the_given_poses_through_a_whole_turn():
    poses = circling(40)
    motion = clip_motion(poses, exposure=2 / 60)
    for frame in (5, 20, 35):
        middle = quat_to_matrix(motion(frame).centre_quats[0])
        given = axis_angle_to_matrix(poses.global_orient[frame])
        torch.testing.assert_close(middle, given, atol=0.02, rtol=0)


def test_exposures_that_overlap_agree_on_where_the_body_was():
    motion = clip_motion(circling(40), exposure=4 / 60)
    # An exposure of four frame intervals ends where that of the fourth frame after it begins.
    closing, opening = torch.tensor([1.0]), torch.tensor([0.0])
    torch.testing.assert_close(motion.at(18, closing).quats, motion.at(22, opening).quats)


def test_halving_the_exposure_halves_the_motion_inside_it():
    def travel(exposure: float) -> float:
        seen = clip_motion(circling(40), exposure)(20)
        return float((seen.transl[-1] - seen.transl[0]).detach().norm())

    assert travel(2 / 60) == pytest.approx(2 * travel(1 / 60), rel=0.05)


def test_a_frame_pulls_on_the_knots_around_it_alone():
    motion = clip_motion(circling(40), exposure=1 / 60)
    motion(20).transl.sum().backward()
    pulled = motion.transl.grad.abs().sum(1) > 0
    assert 4 <= int(pulled.sum()) <= 6


def test_a_clip_trajectory_survives_being_saved(tmp_path):
    motion = clip_motion(circling(12), exposure=2 / 60)
    motion.to_artifact(torch.zeros(2), torch.arange(12) / 60).save(tmp_path / "motion")
    again = trajectory_from_artifact(Motion.load(tmp_path / "motion"))
    torch.testing.assert_close(again(7).quats, motion(7).quats, atol=0, rtol=0)
    torch.testing.assert_close(again(7).transl, motion(7).transl, atol=0, rtol=0)


def test_only_as_many_instants_are_fitted_as_an_exposure_is_given():
    motion = clip_motion(circling(12), exposure=2 / 60)
    counts = torch.full((12,), 5)
    counts[3] = 1
    motion.samples_per_frame.copy_(counts)
    assert motion(3).quats.shape[0] == 1
    assert torch.equal(motion(3).transl[0], motion(3).centre_transl)
    assert motion(4).quats.shape[0] == 5
    artifact = motion.to_artifact(torch.zeros(2), torch.arange(12) / 60)
    assert artifact.num_samples.tolist() == counts.tolist()
    assert artifact.transl.shape[:2] == (12, 5)  # sampled evenly all the same
    assert trajectory_from_artifact(artifact)(3).quats.shape[0] == 1


def test_nothing_is_held_against_a_trajectory_that_has_not_moved(sharpened):
    motion = clip_motion(circling(12), exposure=2 / 60)
    assert prior(motion, "anchor", sharpened) == pytest.approx(0, abs=1e-9)
    motion.log_shutter.requires_grad_()
    assert prior(motion, "shutter", sharpened) == 0


def prior(motion, name, sharpened):
    """One of the penalties at the first exposure, of a clip that knows no depth."""
    return float(motion.priors(0, motion(0), sharpened(depth_known=False))[name]())


def test_the_anchor_weighs_shifts_against_turns(sharpened):
    turned, shifted = (clip_motion(circling(12), exposure=2 / 60) for _ in range(2))
    with torch.no_grad():
        turned.axis_angle[:, 1, 0] += 0.1  # one joint, which did not turn before
        shifted.transl[:, 1] += 0.1 * LEVER
    unit = sharpened().pose_std ** 2
    assert prior(turned, "anchor", sharpened) == pytest.approx(0.01 / 24 / unit, rel=1e-3)
    assert prior(shifted, "anchor", sharpened) == pytest.approx(0.01 / unit, rel=1e-3)


def test_poses_that_may_be_farther_off_hold_the_trajectory_less(sharpened):
    motion = clip_motion(circling(12), exposure=2 / 60)
    with torch.no_grad():
        motion.axis_angle[:, 1, 0] += 0.1
    near, far = (
        float(motion.priors(0, motion(0), sharpened(pose_std=std))["anchor"]())
        for std in (0.02, 0.04)
    )
    assert near == pytest.approx(4 * far)


def test_the_shutter_is_an_unknown_only_where_it_is_estimated():
    poses, times = circling(12), torch.arange(12) / 60
    for estimated in (False, True):
        motion = ClipMotion.near(
            poses, instants(5, "midpoints"), times, 2 / 60, 2 / 60, 0.0, estimate_shutter=estimated
        )
        assert motion.log_shutter.requires_grad is estimated
        with torch.no_grad():
            motion.log_shutter.fill_(math.log(1.5))
        found = motion.to_artifact(poses.betas, times).shutter
        assert found == (pytest.approx(3 / 60, rel=1e-4) if estimated else None)


def test_how_far_an_estimated_shutter_was_is_remembered_until_it_is_settled():
    poses, times = circling(12), torch.arange(12) / 60
    motion = ClipMotion.near(
        poses, instants(5, "midpoints"), times, 2 / 60, 2 / 60, 0.0, estimate_shutter=True
    )
    with torch.no_grad():
        motion.log_shutter.fill_(0.3)
    motion.remember_halfway()
    assert float(motion.state_dict()["halfway"]) == pytest.approx(0.3)
    settled = trajectory_from_artifact(motion.to_artifact(poses.betas, times))
    assert "halfway" not in settled.state_dict()
    assert not settled.log_shutter.requires_grad
    found = settled.to_artifact(poses.betas, times).shutter  # what a later stage saves
    assert found == pytest.approx(2 / 60 * math.exp(0.3), rel=1e-4)
    torch.testing.assert_close(settled(7).transl, motion(7).transl)


def test_a_longer_shutter_sees_more_of_the_motion_and_is_bounded():
    motion = clip_motion(circling(40), exposure=1 / 60)

    def travel() -> float:
        seen = motion(20)
        return float((seen.transl[-1] - seen.transl[0]).detach().norm())

    before = travel()
    with torch.no_grad():
        motion.log_shutter.fill_(math.log(2))
        assert travel() == pytest.approx(2 * before, rel=0.05)
        motion.log_shutter.fill_(100.0)
        assert travel() == pytest.approx(4 * before, rel=0.05)


def test_the_pictures_pull_on_the_shutter():
    motion = ClipMotion.near(
        circling(40), instants(5, "midpoints"), torch.arange(40) / 60, 1 / 60, 2 / 60, 0.0,
        estimate_shutter=True,
    )  # fmt: skip
    # Further at the end of the exposure: it must have been longer.
    motion(20).transl[-1].sum().backward()
    assert float(motion.log_shutter.grad) > 0


def test_a_trajectory_remembers_where_it_started(tmp_path):
    motion = clip_motion(circling(12), exposure=2 / 60)
    before = motion(7)
    with torch.no_grad():
        motion.transl.add_(1.0)
        motion.axis_angle.add_(0.1)
    first = motion.initial(7)
    torch.testing.assert_close(first.centre_transl, before.centre_transl)
    torch.testing.assert_close(first.centre_quats, before.centre_quats)
    motion.to_artifact(torch.zeros(2), torch.arange(12) / 60).save(tmp_path / "motion")
    again = trajectory_from_artifact(Motion.load(tmp_path / "motion"))
    torch.testing.assert_close(again.initial(7).centre_transl, before.centre_transl)
    assert again(7).centre_transl[0] > before.centre_transl[0] + 0.9
