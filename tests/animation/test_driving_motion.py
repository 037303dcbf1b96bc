import pytest
import torch

from deblur_avatar.animation.driving_motion import BodyMotion, resample
from deblur_avatar.geometry.rotations import axis_angle_to_matrix


def turning(frames=5, fps=10.0, step=0.3):
    """A body that turns about +Y at a constant rate while its left knee bends, moving along +X."""
    time = torch.arange(frames, dtype=torch.float32)
    body_pose = torch.zeros(frames, 23, 3)
    body_pose[:, 3, 0] = 0.1 * time
    return BodyMotion(
        fps=fps,
        global_orient=torch.stack([0 * time, step * time, 0 * time], 1),
        body_pose=body_pose,
        transl=torch.stack([time, 0 * time, 0 * time], 1),
    )


def test_more_frames_fall_evenly_between_the_given_ones():
    made = resample(turning(), fps=40.0, start=0.0, seconds=10.0)
    assert len(made.transl) == 17
    torch.testing.assert_close(made.transl[:, 0], torch.arange(17) / 4)
    torch.testing.assert_close(made.global_orient[:, 1], 0.3 * torch.arange(17) / 4)
    torch.testing.assert_close(made.body_pose[:, 3, 0], 0.1 * torch.arange(17) / 4)
    assert made.fps == 40.0


def test_the_same_rate_changes_nothing():
    motion = turning()
    made = resample(motion, fps=10.0, start=0.0, seconds=motion.seconds)
    torch.testing.assert_close(made.global_orient, motion.global_orient)
    torch.testing.assert_close(made.body_pose, motion.body_pose)
    torch.testing.assert_close(made.transl, motion.transl)


@pytest.mark.parametrize(("fps", "frames"), [(10.0, 3), (25.0, 6), (7.0, 2), (30.0, 7)])
def test_start_and_seconds_cut_a_part_out(fps, frames):
    made = resample(turning(), fps=fps, start=0.1, seconds=0.2)
    assert len(made.transl) == frames
    assert made.transl[0, 0] == pytest.approx(1.0)
    assert made.transl[-1, 0] == pytest.approx(1.0 + 10 * (frames - 1) / fps, abs=1e-5)


def test_frames_turn_along_the_shorter_arc():
    half = torch.tensor([[0.0, 3.0, 0.0], [0.0, -3.0, 0.0]])  # 16 degrees apart across half a turn
    motion = BodyMotion(
        fps=1.0, global_orient=half, body_pose=torch.zeros(2, 23, 3), transl=torch.zeros(2, 3)
    )
    middle = axis_angle_to_matrix(resample(motion, 2.0, 0.0, 1.0).global_orient)[1]
    expected = axis_angle_to_matrix(torch.tensor([0.0, torch.pi, 0.0]))
    torch.testing.assert_close(middle, expected, atol=1e-5, rtol=0)


def test_a_single_frame_stays_one():
    made = resample(turning(frames=1), fps=30.0, start=0.0, seconds=4.0)
    assert made.transl.shape == (1, 3)


def test_a_start_after_the_end_is_refused():
    with pytest.raises(ValueError, match=r"lasts 0\.40 s, it cannot start at 1 s"):
        resample(turning(), fps=30.0, start=1.0, seconds=1.0)
