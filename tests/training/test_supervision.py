import pytest
import torch

from deblur_avatar.avatars.avatar import Rendering
from deblur_avatar.motion.pair import PairMotion
from deblur_avatar.motion.trajectory import instants
from deblur_avatar.training.supervision import MASKS, SUPERVISIONS, Exposure, still_frames

C, B, S = 0.2, 0.6, 3  # grey levels of the sharp and the averaged render, instants
C_ALPHA, B_ALPHA = 0.4, 0.5  # their coverage
SHARE = 0.25  # of B in F


def rendered(level, alphas, count):
    """A picture of one level, and coverage."""
    image = torch.full((len(alphas), 2, 2, 3), level)
    return Rendering(image, torch.tensor(alphas)[:, None, None].expand(-1, 2, 2), count, None)


EXPOSURE = Exposure(rendered(B, [0.0, 0.5, 1.0], S), rendered(C, [0.4], 1))


def compared(name, iteration, still, blended, exposure=EXPOSURE):
    """Shares, levels and coverage of what is compared, and what the fusion network saw."""
    seen = []

    def blend(render):
        seen.append(float(render.mean()))
        return torch.full((2, 2, 1), SHARE)

    found = SUPERVISIONS[name].compared(
        exposure, blend if blended else None, float(iteration), lambda: still
    )
    means = [(one.image.mean(), one.alpha.mean()) for one in found]
    levels = [tuple(pytest.approx(float(mean)) for mean in pair) for pair in means]
    return [(one.share, *pair) for one, pair in zip(found, levels, strict=True)], seen


def blended(sharp, mean):
    return (1 - SHARE) * sharp + SHARE * mean


@pytest.mark.parametrize(
    ("name", "level", "alpha"),
    [("mean", B, B_ALPHA), ("fused", blended(C, B), blended(C_ALPHA, B_ALPHA))],
)
def test_a_plain_supervision_compares_one_render_throughout(name, level, alpha):
    for iteration in (0, 4000, 14000):
        assert compared(name, iteration, False, True)[0] == [(1.0, level, alpha)]


def test_without_an_exposure_the_middle_is_compared():
    still = Exposure(rendered(C, [0.4], 1), None)
    assert compared("sharp", 0, False, False, still)[0] == [(1.0, C, C_ALPHA)]
    assert not SUPERVISIONS["sharp"].averages


def test_the_fusion_network_sees_the_sharp_render_and_the_released_one_the_mean():
    assert compared("fused", 9000, False, True)[1] == [pytest.approx(C)]
    assert compared("released", 9000, False, True)[1] == [pytest.approx(RELEASED_B)]


RELEASED_B = (S * B + C) / (S + 1)  # the sharp render is one more instant
RELEASED_ALPHA = (S * B_ALPHA + C_ALPHA) / (S + 1)
SHARP, MEAN = (1.0, C, C_ALPHA), (1.0, RELEASED_B, RELEASED_ALPHA)
FUSED = (1.0, blended(C, RELEASED_B), blended(C_ALPHA, RELEASED_ALPHA))
MOVING = (0.1, C, C_ALPHA)


@pytest.mark.parametrize(
    ("iteration", "still", "wanted"),
    [
        (3001, False, [SHARP, MEAN]),
        (4999, True, [SHARP, MEAN]),
        (5000, False, [MOVING]),
        (6999, True, [SHARP]),
        (7000, False, [MOVING, FUSED]),
        (15000, True, [SHARP, FUSED]),
    ],
)
def test_the_released_code_changes_what_it_compares(iteration, still, wanted):
    assert compared("released", iteration, still, blended=iteration >= 7000)[0] == wanted


@pytest.mark.parametrize(
    ("mask", "supervision", "covered"),
    [
        ("mean", "mean", 0.5),
        ("union", "mean", 1.0),
        ("centre", "mean", 0.4),
        ("mean", "released", (3 * 0.5 + 0.4) / 4),
    ],
)
def test_coverage_is_that_of_the_instants_or_of_the_middle(mask, supervision, covered):
    found = MASKS[mask].of(EXPOSURE, SUPERVISIONS[supervision])
    torch.testing.assert_close(found, torch.full((2, 2), covered))


def test_a_tenth_of_the_frames_are_still_those_that_turn_least(swinging):
    motion = PairMotion(swinging(20, 1.0), instants(3, "endpoints"), 0.0, torch.Generator())
    with torch.no_grad():
        motion.end[:, 5, 0] += torch.linspace(1, 0.1, 20)
    assert still_frames(motion, list(range(20))) == {18, 19}
