"""Unseen sides take the colours of the seen ones, place by place along a limb."""

import numpy as np
import pytest
import torch

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES
from deblur_avatar.avatars.limb_bands import FEWEST, LimbPlaces, band_colors, limb_places
from deblur_avatar.bodies.posed_body import shaped_joints, shaped_vertices

RED, BLUE, WHITE = [0.8, 0.1, 0.1], [0.1, 0.1, 0.8], [0.9, 0.9, 0.9]


TRUNK = 0


def places(limbs, along):
    """Limbs 1 and 2 are those of two sides."""
    count = len(along)
    limbs = np.broadcast_to(limbs, count)
    return LimbPlaces(limbs, np.asarray(along, float), np.zeros(count, bool), TRUNK, (0, 2, 1, 3))


def banded(body, means, joint):
    """Places of points that move with one joint, on the body at rest."""
    betas = torch.zeros(body.shape_dirs.shape[2])
    weights = torch.zeros(len(means), len(SMPL_JOINT_NAMES))
    weights[:, SMPL_JOINT_NAMES.index(joint)] = 1
    vertices = shaped_vertices(body, betas)
    return limb_places(means, weights, shaped_joints(body, betas), vertices, body)


def test_a_hem_is_where_it_is_on_the_other_side():
    along = np.tile(np.linspace(0, 0.4, 81), 2)
    seen = np.arange(162) < 81
    truth = np.where(along[:, None] < 0.201, [RED], [BLUE])
    colors = np.where(seen[:, None], truth, [WHITE])
    found = band_colors(colors, seen.astype(float), places(3, along))
    away = np.abs(along - 0.201) > 0.011
    np.testing.assert_array_equal(found[away], truth[away])


@pytest.mark.parametrize(
    ("size", "trunk", "copied"),
    [(0.04, False, False), (0.04, True, False), (0.07, False, True), (0.07, True, False)],
)
def test_a_print_is_no_colour_of_the_back_and_on_the_trunk_it_may_be_larger(size, trunk, copied):
    along = np.linspace(0, 0.5, 101)
    inside = np.abs(along - 0.251) < size / 2
    colors = np.where(inside[:, None], [WHITE], [RED])
    found = band_colors(colors, np.ones(101), places(TRUNK if trunk else 3, along))
    assert (found == WHITE).all(1).any() == copied
    assert (found[~inside & (np.abs(along - 0.25) > 0.1)] == RED).all()


def test_what_shows_more_tells_more():
    along, told = np.zeros(30), np.ones(30)
    colors = np.where(np.arange(30)[:, None] < 10, [BLUE], [RED])
    assert (band_colors(colors, told, places(3, along)) == RED).all()
    told[:10] = 2.1
    assert (band_colors(colors, told, places(3, along)) == BLUE).all()


def test_limbs_tell_nothing_of_each_other_and_one_that_shows_nothing_is_not_known():
    limbs, along = np.repeat([0, 1, 3], 20), np.zeros(60)
    colors = np.repeat([RED, BLUE, WHITE], 20, axis=0)
    told = np.ones(60)
    told[40 + FEWEST - 1 :] = 0
    found = band_colors(colors, told, places(limbs, along))
    np.testing.assert_array_equal(found[:40], colors[:40])
    assert np.isnan(found[40:]).all()
    told[40 + FEWEST - 1] = 1
    np.testing.assert_array_equal(band_colors(colors, told, places(limbs, along)), colors)


@pytest.mark.parametrize("limb", [1, 2])
@pytest.mark.parametrize(("shown", "hidden"), [(0, True), (16, True), (17, False)])
def test_a_hidden_limb_has_the_colours_of_the_other_side_place_by_place(limb, shown, hidden):
    """Of 81 places of each limb those of one tell, and some of the other, by their upper end."""
    along = np.tile(np.linspace(0, 0.4, 81), 2)
    here = np.repeat([1, 2], 81) == limb
    sleeve = np.where(along[:, None] < 0.201, [RED], [BLUE])
    colors = np.where(here[:, None], [WHITE], sleeve)
    told = (~here | (np.arange(162) % 81 < shown)).astype(float)
    found = band_colors(colors, told, places(np.repeat([1, 2], 81), along))
    below = along > 0.2 + 0.011
    np.testing.assert_array_equal(found[~here & below], sleeve[~here & below])
    np.testing.assert_array_equal(found[here & below], (sleeve if hidden else colors)[here & below])
    none = band_colors(colors, np.zeros(162), places(np.repeat([1, 2], 81), along))
    assert np.isnan(none).all()


def test_limbs_of_the_other_side(body):
    found = banded(body, torch.zeros(1, 3), "pelvis")
    names = [*body.joint_names, "scalp"]
    assert found.mirrored[names.index("left_elbow")] == names.index("right_elbow")
    assert found.mirrored[names.index("right_hip")] == names.index("left_hip")
    for name in ("pelvis", "neck", "head", "scalp"):
        assert found.mirrored[names.index(name)] == names.index(name)


def test_where_little_is_seen_of_a_place_the_nearest_of_the_limb_tell():
    along = np.concatenate([np.linspace(0, 0.05, 20), [0.051, 0.4]])
    colors = np.concatenate([np.repeat([RED], 20, 0), [WHITE, BLUE]])  # white by chance
    told = (np.arange(22) < 21).astype(float)
    assert (band_colors(colors, told, places(3, along))[21] == RED).all()


def test_of_two_halves_the_first_is_the_median():
    along, told = np.zeros(10), np.ones(10)
    colors = np.where(np.arange(10)[:, None] < 5, [[0.2]], [[0.7]])
    assert (band_colors(colors, told, places(3, along)) == 0.2).all()


def test_order_does_not_matter():
    generator = np.random.default_rng(2)
    along, colors, told = generator.random(80), generator.random((80, 3)), generator.random(80)
    limbs = generator.integers(0, 3, 80)
    found = band_colors(colors, told, places(limbs, along))
    order = generator.permutation(80)
    again = band_colors(colors[order], told[order], places(limbs[order], along[order]))
    np.testing.assert_array_equal(again, found[order])


def test_limbs_are_measured_along_their_bones_and_the_trunk_by_height(body):
    joints = shaped_joints(body, torch.zeros(body.shape_dirs.shape[2]))
    elbow, wrist = (SMPL_JOINT_NAMES.index(f"left_{name}") for name in ("elbow", "wrist"))
    shares = torch.tensor([0.2, 0.5, 0.8])
    middle = torch.lerp(joints[elbow], joints[wrist], shares[:, None])
    around = torch.cat([middle + torch.tensor([0.0, 0.04, 0.0]),
                        middle - torch.tensor([0.0, 0.0, 0.04])])  # fmt: skip
    found = banded(body, around, "left_elbow")
    assert (found.limbs == found.limbs[0]).all()
    length = float((joints[wrist] - joints[elbow]).norm())
    np.testing.assert_allclose(found.along, np.tile(shares, 2) * length, atol=2e-3)
    chest = torch.tensor([[0.05, 0.05, 0.13], [-0.05, 0.2, -0.12], [0.0, 0.33, 0.1]])
    for joint in ("pelvis", "spine1", "spine3", "left_collar"):
        found = banded(body, chest, joint)
        assert (found.limbs == found.trunk).all()
        np.testing.assert_allclose(found.along, chest[:, 1], atol=1e-6)
    for joint in ("neck", "head"):
        steps = np.diff(banded(body, chest, joint).along)
        np.testing.assert_allclose(steps, np.diff(chest[:, 1]), atol=1e-6)


@pytest.mark.parametrize(
    ("part", "limb"), [("left_foot", "left_ankle"), ("left_hand", "left_wrist")]
)
def test_toes_are_of_the_foot_and_fingers_of_the_hand(body, part, limb):
    means = torch.tensor([[0.1, -0.9, 0.1], [0.8, 0.44, 0.0]])
    whole, end = banded(body, means, limb), banded(body, means, part)
    np.testing.assert_array_equal(end.limbs, whole.limbs)
    np.testing.assert_array_equal(end.along, whole.along)


def test_a_thigh_is_measured_to_its_knee(body):
    joints = shaped_joints(body, torch.zeros(body.shape_dirs.shape[2]))
    hip, knee = (joints[SMPL_JOINT_NAMES.index(f"left_{name}")] for name in ("hip", "knee"))
    found = banded(body, torch.stack([hip, knee]), "left_hip")
    np.testing.assert_allclose(found.along, [0, float((knee - hip).norm())], atol=1e-6)


def test_the_scalp_is_one_and_the_face_is_none_of_it(body):
    head = shaped_joints(body, torch.zeros(body.shape_dirs.shape[2]))[
        SMPL_JOINT_NAMES.index("head")
    ] + torch.tensor([0.0, 0.065, 0.0])  # the middle of the capsule's
    crown, back, hairline, brow, chin, nape = (
        head + torch.tensor(away) for away in (
            [0.0, 0.155, -0.01], [0.0, 0.02, -0.09], [0.0, 0.14, 0.06], [0.0, 0.02, 0.1],
            [0.0, -0.09, 0.08], [0.0, -0.11, -0.08],
        )
    )  # fmt: skip
    points = torch.stack([crown, back, hairline, brow, chin, nape])
    found = banded(body, points, "head")
    scalp = found.limbs == len(SMPL_JOINT_NAMES)
    assert scalp.tolist() == [True, True, True, False, False, False]
    assert found.behind.tolist() == [True, True, False, False, False, False]
    assert (found.along[scalp] == 0).all()
    others = banded(body, points, "neck")
    assert (others.limbs == SMPL_JOINT_NAMES.index("neck")).all()
