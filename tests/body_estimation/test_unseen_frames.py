import pytest
import torch

from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.body_estimation.unseen_frames import EASE_S, between_seen

FRAMES = 31
TIMES = torch.arange(FRAMES) / 30


def gone(first: int, last: int) -> torch.Tensor:
    return (torch.arange(FRAMES) >= first) & (torch.arange(FRAMES) <= last)


def bowing(lost: torch.Tensor) -> Poses:
    """All of it moves evenly, but that it stands at rest and a metre off where it is lost."""
    share = (torch.arange(FRAMES) / FRAMES)[:, None]
    turn = share * torch.tensor([[0.3, -0.2, 0.5]])
    rest = torch.where(lost[:, None], 0.0, turn)
    return Poses(
        betas=torch.zeros(2), global_orient=rest, body_pose=rest[:, None].repeat(1, 23, 1),
        transl=share.repeat(1, 3) + lost[:, None],
    )  # fmt: skip


def test_who_is_not_seen_does_not_go_to_rest():
    lost = gone(8, 22)
    poses, even = bowing(lost), bowing(gone(99, 99))
    filled = between_seen(poses, ~lost, TIMES)
    far = gone(8 + round(30 * EASE_S), 22 - round(30 * EASE_S))
    assert far.sum() > 5
    for name in ("global_orient", "body_pose", "transl"):
        found = getattr(filled, name)
        torch.testing.assert_close(found[far], getattr(even, name)[far], atol=1e-5, rtol=0)
        assert torch.equal(found[~lost], getattr(poses, name)[~lost])


def test_beside_frames_that_are_seen_poses_go_over_into_the_fit_s():
    lost = gone(8, 22)
    poses = bowing(lost)
    filled = between_seen(poses, ~lost, TIMES)
    even = bowing(gone(99, 99)).transl
    shares = ((filled.transl - poses.transl) / (even - poses.transl))[lost, 0]
    expected = [t * t * (3 - 2 * t) for t in (1 / 3, 2 / 3, 1.0)]
    assert shares[:3].tolist() == pytest.approx(expected, abs=1e-4)
    assert shares.flip(0)[:3].tolist() == pytest.approx(expected, abs=1e-4)


def test_nobody_moves_before_the_first_and_after_the_last():
    lost = gone(0, 9) | gone(20, FRAMES)
    filled = between_seen(bowing(lost), ~lost, TIMES)
    for far, nearest in ((slice(0, 7), 10), (slice(23, FRAMES), 19)):
        wanted = filled.body_pose[nearest].expand_as(filled.body_pose[far])
        torch.testing.assert_close(filled.body_pose[far], wanted, atol=1e-5, rtol=0)


def test_poses_are_returned_where_all_frames_or_none_are_seen():
    poses = bowing(gone(8, 22))
    for seen in (torch.ones(FRAMES), torch.zeros(FRAMES)):
        assert between_seen(poses, seen > 0, TIMES) is poses
