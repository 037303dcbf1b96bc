import pytest
import torch

from deblur_avatar.avatars.one_sided_avatar import OneSidedAvatar
from deblur_avatar.evaluation import torn_parts
from deblur_avatar.evaluation.torn_parts import CLOSED_PARTS, parts_open


def test_a_whole_avatar_is_open_nowhere(avatar, motion):
    assert parts_open(avatar, motion, 0) == dict.fromkeys(CLOSED_PARTS, 0.0)


def test_an_open_crown_counts_as_near_to_the_silhouette_as_the_avatar_is_closed(
    avatar, motion, monkeypatch
):
    tops = avatar.gaussians.means[:, 1]
    with torch.no_grad():
        avatar.gaussians.opacity_logits[tops > tops.max() - 0.06] = -30.0
    plain = parts_open(avatar, motion, 0)
    monkeypatch.setattr(type(avatar), "closed_nearer", OneSidedAvatar.closed_nearer)
    nearer = parts_open(avatar, motion, 0)
    assert nearer["head"] > plain["head"] + 0.03
    del plain["head"], nearer["head"]
    assert plain == nearer


@pytest.mark.parametrize(("deep", "near"), [(0.3, 0.1), (0.1, 0.3)])
def test_of_two_looks_at_a_head_the_worse_one_counts(avatar, motion, monkeypatch, deep, near):
    """A hole deep inside is a smaller share of more pixels; one near the rim is in these alone."""
    shares = {False: {"head": deep}, True: {"head": near}}
    monkeypatch.setattr(torn_parts, "_parts_open", lambda *asked: shares[bool(asked[-1])])
    monkeypatch.setattr(type(avatar), "closed_nearer", OneSidedAvatar.closed_nearer)
    assert parts_open(avatar, motion, 0) == {"head": 0.3}
