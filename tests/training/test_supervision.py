import pytest
import torch

from deblur_avatar.motion.pair import PairMotion
from deblur_avatar.motion.trajectory import instants
from deblur_avatar.training.supervision import shares, still_frames


@pytest.mark.parametrize("supervision", ["sharp", "mean", "fused"])
def test_a_plain_supervision_compares_one_render_throughout(supervision):
    for iteration in (0, 4000, 14000):
        assert shares(supervision, float(iteration), False, True) == {supervision: 1.0}


@pytest.mark.parametrize(
    ("iteration", "still", "wanted"),
    [
        (3001, False, {"sharp": 1.0, "mean": 1.0}),
        (4999, True, {"sharp": 1.0, "mean": 1.0}),
        (5000, False, {"sharp": 0.1}),
        (6999, True, {"sharp": 1.0}),
        (7000, False, {"sharp": 0.1, "fused": 1.0}),
        (15000, True, {"sharp": 1.0, "fused": 1.0}),
    ],
)
def test_the_released_code_changes_what_it_compares(iteration, still, wanted):
    assert shares("released", float(iteration), still, blended=iteration >= 7000) == wanted


def test_a_tenth_of_the_frames_are_still_those_that_turn_least(swinging):
    motion = PairMotion(swinging(20, 1.0), instants(3, "endpoints"), 0.0, torch.Generator())
    with torch.no_grad():
        motion.end[:, 5, 0] += torch.linspace(1, 0.1, 20)
    assert still_frames(motion, list(range(20))) == {18, 19}
