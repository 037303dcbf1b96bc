import math

import pytest
import torch

from deblur_avatar.errors import ArtifactError
from deblur_avatar.sources.missing_poses import LONGEST, fill_missing


def turning(frames):
    """A body that turns by a tenth of a radian a frame and walks a metre."""
    turns = torch.zeros(frames, 2, 3)
    turns[:, 0, 1] = 0.1 * torch.arange(frames)
    return turns, torch.arange(frames)[:, None].repeat(1, 3).float()


def without(frames, lost):
    turns, transl = turning(frames)
    turns[lost], transl[lost] = math.nan, math.nan
    return turns, transl


def test_poses_between_others_are_found_again_where_motion_is_even(caplog):
    turns, transl = fill_missing(*without(12, [1, 4, 5, 6, 10]), "a.npz")
    expected = turning(12)
    torch.testing.assert_close(turns, expected[0], atol=1e-5, rtol=0)
    torch.testing.assert_close(transl, expected[1])
    assert "a.npz: 5 of 12 frames have no pose, up to 3 in a row" in caplog.text


def test_rotations_take_the_shorter_way_round():
    turns, transl = torch.zeros(3, 1, 3), torch.zeros(3, 3)
    turns[0, 0, 1], turns[2, 0, 1] = 3.0, -3.0
    turns[1], transl[1] = math.nan, math.nan
    filled, _ = fill_missing(turns, transl, "a.npz")
    assert abs(float(filled[1, 0, 1])) == pytest.approx(math.pi, abs=1e-4)


def test_complete_poses_are_the_very_same():
    turns, transl = turning(4)
    filled = fill_missing(turns, transl, "a.npz")
    assert filled[0] is turns
    assert filled[1] is transl


@pytest.mark.parametrize(
    ("frames", "lost", "message"),
    [
        (5, [0], "1 of 5 frames have no pose, the first or the last"),
        (5, [4], "the first or the last"),
        (8, [1, 2, 3, 5, 6], "5 of 8 frames have no pose, up to 3 in a row; at most half"),
        (60, list(range(2, 3 + LONGEST)), "up to 16 in a row"),
        (3, [0, 1, 2], "3 of 3 frames have no pose"),
    ],
)
def test_what_cannot_be_filled_is_refused(frames, lost, message):
    with pytest.raises(ArtifactError, match=message):
        fill_missing(*without(frames, lost), "a.npz")


def test_a_single_number_that_is_none_is_no_missing_pose():
    turns, transl = turning(4)
    transl[2] = math.nan
    assert fill_missing(turns, transl, "a.npz")[1] is transl
