import torch

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES
from deblur_avatar.body_estimation.pose_limits import pose_limits


def row(name: str) -> int:
    return SMPL_JOINT_NAMES.index(name) - 1


def allowed(name: str, pose: list[float], seen_hands: tuple[str, ...] = ()) -> bool:
    limits = pose_limits(seen_hands)
    values = torch.deg2rad(torch.tensor(pose))
    inside = (values >= limits.low[row(name)]) & (values <= limits.high[row(name)])
    return bool(inside.all())


def test_the_rest_pose_is_allowed():
    limits = pose_limits()
    assert (limits.low <= 0).all()
    assert (limits.high >= 0).all()
    assert (limits.std > 0).all()


def test_knees_and_elbows_bend_one_way():
    assert allowed("left_knee", [90, 0, 0])
    assert not allowed("left_knee", [-30, 0, 0])
    assert allowed("left_elbow", [0, -90, 0])
    assert not allowed("left_elbow", [0, 30, 0])


def test_the_right_side_is_the_left_in_a_mirror():
    assert allowed("right_elbow", [0, 90, 0])
    assert not allowed("right_elbow", [0, -30, 0])
    assert allowed("right_shoulder", [0, 0, 80])  # the arm hangs
    assert allowed("left_shoulder", [0, 0, -80])
    assert allowed("right_hip", [0, 0, -60])  # the leg is spread
    assert not allowed("right_hip", [0, 0, 60])


def test_fingers_bend_towards_the_palm_where_hands_were_seen():
    for name, sign in (("left_hand", 1), ("right_hand", -1)):
        fist = [0, 0, -90 * sign]
        assert not allowed(name, fist)
        assert allowed(name, fist, (name,))
        assert not allowed(name, [0, 0, 60 * sign], (name,))  # backwards
        other = {"left_hand": "right_hand", "right_hand": "left_hand"}[name]
        assert not allowed(name, fist, (other,))
