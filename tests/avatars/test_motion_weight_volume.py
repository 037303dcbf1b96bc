import pytest
import torch

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES, SMPL_PARENTS
from deblur_avatar.avatars.motion_weight_volume import (
    MotionWeightsParams,
    MotionWeightVolume,
    bone_prior,
    taken_back,
)
from deblur_avatar.config.reading import parse
from deblur_avatar.errors import ConfigError
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.geometry.skinning import invert_rigid
from tests.randomness import seeded

pytestmark = pytest.mark.portable

SIZES = {"margin_m": 0.3, "code": 8, "dense": 6, "channels": [5, 4]}
KNEE, ANKLE, HEAD, HAND = (
    SMPL_JOINT_NAMES.index(name) for name in ("left_knee", "left_ankle", "head", "left_hand")
)


def named(points, joints):
    return bone_prior(points, joints, SMPL_PARENTS, SMPL_JOINT_NAMES)


@pytest.fixture
def joints(body):
    return body.joints


@pytest.fixture
def own(joints):
    params = parse(MotionWeightsParams, SIZES, "motion_weights")
    return MotionWeightVolume(joints, SMPL_PARENTS, SMPL_JOINT_NAMES, params, seeded())


def test_weights_and_air_sum_to_one(own, joints):
    volume = own()
    assert volume.shape == (24, 8, 8, 8)
    assert volume.min() > 0
    assert (volume.sum(0) < 1).all()
    prior = named(torch.randn(50, 3, generator=seeded()), joints)
    torch.testing.assert_close(prior.sum(0), torch.ones(50))


def test_a_joints_prior_is_largest_in_the_middle_of_its_bone(joints):
    middle = (joints[KNEE] + joints[ANKLE]) / 2
    around = middle + 0.1 * torch.nn.functional.normalize(
        torch.randn(40, 3, generator=seeded()), dim=1
    )
    at = named(torch.cat([middle[None], around]), joints)[KNEE]
    assert at[0] > 0.95
    assert (at[1:] < at[0]).all()


def test_a_bones_gaussian_is_twice_as_long_as_wide_and_as_the_release_has_it(joints):
    middle = (joints[KNEE] + joints[ANKLE]) / 2
    along = torch.nn.functional.normalize(joints[ANKLE] - joints[KNEE], dim=0)
    across = torch.nn.functional.normalize(torch.linalg.cross(along, torch.eye(3)[2]), dim=0)
    prior = named(torch.stack([middle + 0.06 * along, middle + 0.06 * across]), joints)
    # Nothing else is near: air takes what the bone leaves, so that they sum to 1 as they are.
    wanted = [torch.tensor(-((0.06 / (2 * std)) ** 2)).exp() for std in (0.06, 0.03)]
    torch.testing.assert_close(prior[KNEE], torch.stack(wanted), atol=1e-3, rtol=0)
    assert float(prior[-1, 1]) == pytest.approx(1 - float(wanted[1]), abs=0.01)


def test_the_trunk_is_wider_and_ends_are_balls(joints):
    pelvis = (joints[0] + joints[3]) / 2  # on the bone to the spine
    aside = torch.tensor([0.0, 0.0, 0.09])
    found = float(named((pelvis + aside)[None], joints)[0, 0])
    assert found > 1.2 * float(torch.tensor(-((0.09 / 0.06) ** 2)).exp())
    for joint, std in ((HEAD, 0.06), (HAND, 0.02)):
        steps = 2 * std * torch.eye(3)
        found = named(joints[joint] + steps, joints)[joint]
        alone = torch.tensor(-1.0).exp()
        assert (found <= alone + 1e-5).all()
        assert found[2] == pytest.approx(float(alone), abs=0.05)


def test_a_joint_with_children_carries_a_bone_to_each_of_them(joints):
    hips = [(joints[0] + joints[child]) / 2 for child in (1, 2, 3)]
    assert (named(torch.stack(hips), joints)[0] > 0.3).all()


def test_far_from_all_bones_is_air(joints):
    prior = named(torch.tensor([[0.0, 0.0, 3.0]]), joints)
    assert float(prior[-1]) == pytest.approx(1.0)
    assert torch.isfinite(prior.clamp(min=1e-6).log()).all()


def test_what_is_learned_is_added_to_the_logarithm_of_the_prior(own):
    silent(own)
    prior = own.log_prior.exp()
    torch.testing.assert_close(own(), (prior / prior.sum(0))[:-1])
    with torch.no_grad():
        own.doublings[-1].bias[KNEE] = 2.0
    more = prior.clone()
    more[KNEE] *= torch.tensor(2.0).exp()
    torch.testing.assert_close(own(), (more / more.sum(0))[:-1])


def silent(own):
    with torch.no_grad():
        own.doublings[-1].weight.zero_()
        own.doublings[-1].bias.zero_()


def test_every_number_of_the_network_has_a_say(own):
    own().square().sum().backward()
    for name, value in own.named_parameters():
        assert value.grad.any(), name


def test_its_first_weights_come_from_the_generator(own, joints):
    torch.manual_seed(9)
    params = parse(MotionWeightsParams, SIZES, "motion_weights")
    again = MotionWeightVolume(joints, SMPL_PARENTS, SMPL_JOINT_NAMES, params, seeded())
    assert torch.equal(own(), again())


def posed(joints, seed=3):
    """Rigid transforms of joints that have nothing to do with each other."""
    transforms = torch.eye(4).repeat(len(joints), 1, 1)
    transforms[:, :3, :3] = axis_angle_to_matrix(torch.randn(24, 3, generator=seeded(seed)))
    transforms[:, :3, 3] = torch.randn(24, 3, generator=seeded(seed + 1))
    return transforms


def test_nodes_are_where_the_prior_was_asked_for_and_outside_all_is_air(own):
    volume, still = own(), torch.eye(4).expand(24, 4, 4)
    step = (own.high - own.low) / 7
    index = torch.tensor([2, 5, 6])  # along x, y, z
    point = own.low + step * index
    found = own.weights_at(volume, point[None], still)[:, 0]
    torch.testing.assert_close(found, volume[:, 6, 5, 2], atol=1e-5, rtol=1e-4)
    outside = torch.stack([own.low - step, own.high + step])
    assert not own.weights_at(volume, outside, still).any()


def test_each_joint_looks_up_where_it_takes_a_point_back_to(own, joints):
    volume, transforms = own(), posed(joints)
    points = torch.randn(30, 3, generator=seeded(5))
    found = own.weights_at(volume, points, invert_rigid(transforms))
    still = torch.eye(4).expand(24, 4, 4)
    for joint in (0, KNEE, HAND):
        back = (points - transforms[joint, :3, 3]) @ transforms[joint, :3, :3]
        wanted = own.weights_at(volume, back, still)[joint]
        torch.testing.assert_close(found[joint], wanted, atol=1e-5, rtol=1e-3)


def test_a_body_at_rest_is_taken_back_to_itself(own):
    points = 0.2 * torch.randn(50, 3, generator=seeded(5))
    still = torch.eye(4).expand(24, 4, 4)
    share, places = taken_back(own.weights_at(own(), points, still), points, still)
    seen = share > 1e-3
    assert seen.float().mean() > 0.5
    torch.testing.assert_close(places[seen], points[seen], atol=1e-5, rtol=0)
    assert (share <= 1 + 1e-6).all()


def test_a_point_that_one_joint_carries_is_moved_as_if_glued_to_it(joints):
    transforms = posed(joints)
    points = torch.randn(4, 3, generator=seeded(5))
    weights = torch.zeros(24, 4)
    weights[KNEE] = 0.25
    share, places = taken_back(weights, points, invert_rigid(transforms))
    torch.testing.assert_close(share, torch.full((4,), 0.25))
    there = places @ transforms[KNEE, :3, :3].T + transforms[KNEE, :3, 3]
    torch.testing.assert_close(there, points, atol=1e-5, rtol=0)


def test_where_several_joints_have_a_say_it_is_the_mean_of_theirs(joints):
    transforms = invert_rigid(posed(joints))
    point = torch.randn(1, 3, generator=seeded(5))
    weights = torch.zeros(24, 1)
    weights[3], weights[8] = 0.1, 0.3
    each = [transforms[j, :3, :3] @ point[0] + transforms[j, :3, 3] for j in (3, 8)]
    share, places = taken_back(weights, point, transforms)
    assert float(share) == pytest.approx(0.4)
    torch.testing.assert_close(places[0], (each[0] + 3 * each[1]) / 4, atol=1e-5, rtol=0)


def test_air_is_taken_back_without_a_division_by_nothing(joints):
    points = torch.randn(2, 3, generator=seeded())
    weights = torch.zeros(24, 2, requires_grad=True)
    share, places = taken_back(weights, points, invert_rigid(posed(joints)))
    (share.sum() + places.sum()).backward()
    assert not places.any()
    assert torch.isfinite(weights.grad).all()


def test_there_are_as_many_nodes_as_doublings_make(joints):
    params = parse(MotionWeightsParams, SIZES | {"channels": [64, 64, 32, 32]}, "motion_weights")
    assert params.nodes == 32
    volume = MotionWeightVolume(joints, SMPL_PARENTS, SMPL_JOINT_NAMES, params, seeded())
    assert volume().shape[1:] == (32, 32, 32)


@pytest.mark.parametrize(
    "change", [{"margin_m": 0.0}, {"code": 0}, {"dense": 0}, {"channels": [0]}]
)
def test_networks_that_cannot_be_made_are_refused(change):
    with pytest.raises(ConfigError, match=next(iter(change))):
        parse(MotionWeightsParams, SIZES | change, "motion_weights")
