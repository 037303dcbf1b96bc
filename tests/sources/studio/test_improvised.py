import torch

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES
from deblur_avatar.sources.studio.improvised import SPIN, improvise
from deblur_avatar.sources.studio.motion import MOTIONS

TIMES = torch.arange(240, dtype=torch.float64) / 480


def drawn(seed: int):
    return improvise(torch.Generator().manual_seed(seed))(TIMES, 0.5)


def test_the_same_seed_moves_alike_and_another_does_not():
    assert torch.equal(drawn(1).axis_angle, drawn(1).axis_angle)
    assert torch.equal(drawn(1).transl, drawn(1).transl)
    assert float((drawn(1).body_pose - drawn(2).body_pose).abs().mean()) > 0.05


def test_a_motion_is_a_smooth_function_of_time():
    motion = improvise(torch.Generator().manual_seed(3))
    apart = motion(TIMES[::2], 0.5)
    assert torch.equal(apart.body_pose, motion(TIMES, 0.5).body_pose[::2])
    jerk = drawn(3).body_pose.diff(n=2, dim=0).abs().max()
    assert float(jerk) < 0.01  # radians from one instant to the next


def test_arms_move_fast_enough_to_blur_and_the_body_turns_no_faster_than_it_says():
    speeds = []
    for seed in range(20):
        moves = drawn(seed)
        shoulder = moves.axis_angle[:, SMPL_JOINT_NAMES.index("left_shoulder")]
        speeds.append(float(shoulder.diff(dim=0).norm(dim=1).mean() * 480))
        turned = float(moves.global_orient[-1, 1] - moves.global_orient[0, 1])
        assert abs(turned) <= 2 * torch.pi * SPIN * float(TIMES[-1]) + 1e-9
    assert 2 < sum(speeds) / len(speeds) < 12  # radians a second


def test_no_scene_moves_so():
    for name, motion in MOTIONS.items():
        away = motion(TIMES, 0.5).body_pose - drawn(0).body_pose
        assert float(away.abs().mean()) > 0.1, name
