import dataclasses
import math

import pytest
import torch

from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.config.reading import parse
from deblur_avatar.errors import ConfigError
from deblur_avatar.geometry.rotations import (
    axis_angle_to_quat,
    quat_conjugate,
    quat_multiply,
    quat_to_axis_angle,
    quat_to_matrix,
)
from deblur_avatar.geometry.splines import basis
from deblur_avatar.motion.kinds import trajectory_from_artifact
from deblur_avatar.motion.mad import KNOTS, MadMotion, MadParams, meeting
from tests.randomness import seeded

FPS = 64  # so that times are exact
CONTENT = {
    "kind": "mad", "virtual_poses": 5, "quadrature": "endpoints", "start_noise": 0.05,
    "pose_network": {"hidden": [8], "rate": 5e-5}, "continuity": "overlap",
    "rates": {"poses": 1e-3, "transl": 1e-4}, "priors": {"continuity": 1.0},
}  # fmt: skip
U = torch.linspace(0, 1, 9, dtype=torch.float64)


def params(**changes) -> MadParams:
    return parse(MadParams, CONTENT | changes, "motion")


def filmed(make_observations, frames=6, overlap=4.1, **changes):
    """Frames that are `overlap` exposures apart."""
    return dataclasses.replace(
        make_observations(frames=frames), timestamps=torch.arange(frames) / FPS,
        exposure=None if overlap is None else overlap / FPS,
        **({"train": tuple(range(frames)), "validation": ()} | changes),
    )  # fmt: skip


@pytest.fixture
def seen(make_observations):
    return filmed(make_observations)


def created(seen, seed=0, **changes):
    return MadMotion.create(seen, params(**changes), seeded(seed))


def bent(seen, **changes):
    """A motion that has left its start, in double precision."""
    motion = created(seen, **changes).double()
    generator = seeded(1)
    with torch.no_grad():
        for value in motion.parameters():
            value.add_(0.1 * torch.randn(value.shape, generator=generator, dtype=value.dtype))
    return motion


def continuity(motion, frame, seen):
    return motion.priors(frame, motion(frame), seen)["continuity"]()


def felt(motion, frame, seen):
    return float(continuity(motion, frame, seen).detach())


def angle(a, b):
    return quat_to_axis_angle(quat_multiply(quat_conjugate(a), b)).norm(dim=-1)


def test_the_curve_is_a_uniform_cubic_b_spline_of_turns_after_the_given_pose(seen):
    motion = bent(seen, pose_network=None)
    here = motion.at(2, U)
    given = axis_angle_to_quat(motion.given[2])
    for place, u in enumerate(U.tolist()):
        weights = [(1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3]
        turn = sum(weight / 6 * motion.offsets[2, k] for k, weight in enumerate(weights))
        transl = sum(weight / 6 * motion.transl[2, k] for k, weight in enumerate(weights))
        quats = quat_multiply(given, axis_angle_to_quat(turn))
        torch.testing.assert_close(here.quats[place], quats)
        torch.testing.assert_close(here.transl[place], transl)
    torch.testing.assert_close(here.quats[4], here.centre_quats)
    torch.testing.assert_close(here.transl[4], here.centre_transl)


@pytest.mark.parametrize("turned", [0.0, 0.3])
def test_equal_knots_are_one_pose_all_along(seen, turned):
    motion = created(seen, pose_network=None).double()
    with torch.no_grad():
        motion.offsets[:] = turned
    here = motion.at(3, U)
    given = axis_angle_to_quat(motion.given[3])
    turn = axis_angle_to_quat(torch.full_like(motion.given[3], turned))
    pose = quat_multiply(given, turn)
    torch.testing.assert_close(here.quats, pose.expand(len(U), -1, -1))
    torch.testing.assert_close(here.centre_quats, pose)
    torch.testing.assert_close(here.transl, motion.transl[3, :1].expand(len(U), 3))


def test_a_curve_run_backward_shows_the_same_poses(seen):
    motion = bent(seen)
    forward = motion(2)
    with torch.no_grad():
        motion.offsets[2] = motion.offsets[2].flip(0)
        motion.transl[2] = motion.transl[2].flip(0)
    backward = motion(2)
    torch.testing.assert_close(backward.quats, forward.quats.flip(0))
    torch.testing.assert_close(backward.transl, forward.transl.flip(0))
    torch.testing.assert_close(backward.centre_quats, forward.centre_quats)
    assert angle(forward.quats[0], forward.quats[-1]).max() > 0.05


def test_a_joint_passes_half_a_turn_without_a_jump(seen):
    pose = seen.poses.body_pose.clone()
    pose[:, 4] = torch.tensor([math.pi - 0.01, 0.0, 0.0])
    near = dataclasses.replace(seen, poses=dataclasses.replace(seen.poses, body_pose=pose))
    motion = created(near, pose_network=None, start_noise=0.0).double()
    with torch.no_grad():
        motion.offsets[:, :, 5, 0] = torch.tensor([-0.1, -0.05, 0.05, 0.1])
    quats = motion.at(1, U).quats[:, 5]
    turned = 2 * torch.atan2(quats[:, 1], quats[:, 0])
    assert turned[0] < math.pi < turned[-1]
    steps = angle(quats[:-1], quats[1:])
    assert 0 < steps.min() <= steps.max() < 0.02


def test_noise_parts_rotations_alone_and_leaves_the_middle(seen):
    motion, other = created(seen), created(seen, seed=1)
    assert torch.equal(motion.offsets, created(seen).offsets)
    assert not torch.equal(motion.offsets, other.offsets)
    assert motion.offsets.mean(1).abs().max() < 1e-7
    assert float(motion.offsets[:, 0, 1:].detach().std()) == pytest.approx(1.5 * 0.05, rel=0.1)
    assert torch.equal(motion.transl, seen.poses.transl[:, None].expand(-1, KNOTS, -1))


def test_the_network_corrects_the_pose_of_every_instant(seen):
    motion = bent(seen)
    corrected = motion.at(2, U)
    network, motion.pose_network = motion.pose_network, None
    plain = motion.at(2, U)
    torch.testing.assert_close(corrected.quats, network(plain.quats))
    torch.testing.assert_close(corrected.centre_quats, network(plain.centre_quats))
    assert torch.equal(corrected.quats[:, 0], plain.quats[:, 0])
    assert torch.equal(corrected.transl, plain.transl)
    turns = angle(plain.quats, corrected.quats)[:, 1:]
    assert (turns[0] - turns[-1]).abs().max() > 1e-3  # not one correction a frame


def smooth(seen, overlap, **changes):
    """A motion whose exposures are pieces of one: cubic in time, each joint about an axis."""
    motion = created(seen, pose_network=None, **changes).double()
    coefficients = torch.randn(4, 24, generator=seeded(2), dtype=torch.float64) * 0.2
    axes = torch.nn.functional.normalize(torch.randn(24, 3, generator=seeded(3)).double(), dim=-1)
    knots, weights = basis(1 + U[::2], KNOTS)
    spline = torch.zeros(5, KNOTS, dtype=torch.float64).scatter_add_(1, knots, weights)

    def turned(time):
        return torch.stack([time**power for power in range(4)], -1) @ coefficients

    with torch.no_grad():
        for frame in range(len(seen.frames)):
            middle = torch.tensor([frame - 2.5], dtype=torch.float64)
            there = turned(middle + (U[::2] - 0.5) * overlap)  # [instants, joints], radians
            along = torch.linalg.lstsq(spline, there - turned(middle)).solution
            motion.given[frame] = turned(middle)[0, :, None] * axes
            motion.offsets[frame] = along[..., None] * axes
            motion.transl[frame] = torch.linalg.lstsq(spline, there[:, :3]).solution
    return motion


def test_one_smooth_motion_goes_on_where_exposures_overlap(make_observations):
    seen = filmed(make_observations, overlap=4.1)
    motion = smooth(seen, 4.1)
    assert max(felt(motion, frame, seen) for frame in range(6)) < 1e-6
    with torch.no_grad():
        motion.offsets[2, 3] += 0.3
    together = [felt(motion, frame, seen) for frame in range(6)]
    assert max(together[0], together[4], together[5]) < 1e-6
    assert min(together[1:4]) > 1e-4


def test_the_published_rule_holds_one_smooth_motion_back(make_observations):
    seen = filmed(make_observations, overlap=4.1)
    assert continuity(smooth(seen, 4.1, continuity="literal"), 2, seen) > 0.1
    touching = filmed(make_observations, overlap=1.0)
    assert continuity(smooth(touching, 1.0, continuity="literal"), 2, touching) < 1e-6


@pytest.mark.parametrize("overlap", [0.0, 0.4, 1.0])
def test_without_an_overlap_both_rules_are_one(make_observations, overlap):
    seen = filmed(make_observations, overlap=overlap)
    rules = [continuity(bent(seen, continuity=rule), 2, seen) for rule in ("overlap", "literal")]
    assert torch.equal(*rules)
    assert rules[0] > 0


def test_the_prior_is_the_mean_angle_and_shift_over_both_neighbours(make_observations):
    seen = filmed(make_observations, overlap=2.0)
    motion = bent(seen)

    def apart(earlier, later):
        pairs = [(0.5, 0.0), (0.75, 0.25), (1.0, 0.5)]
        found = []
        for here, there in pairs:
            a = motion.at(earlier, U.new_tensor([here]))
            b = motion.at(later, U.new_tensor([there]))
            joints = [
                float(angle(p, q).detach()) for p, q in zip(a.quats[0], b.quats[0], strict=True)
            ]
            found.append(sum(joints) / 24 + float((a.transl - b.transl).detach().abs().sum()) / 3)
        return sum(found) / 3

    expected = (apart(1, 2) + apart(2, 3)) / 2
    assert felt(motion, 2, seen) == pytest.approx(expected)
    assert felt(motion, 0, seen) == pytest.approx(apart(0, 1))
    assert felt(motion, 5, seen) == pytest.approx(apart(4, 5))


def test_neighbours_are_fitted_frames_that_show_a_person(make_observations):
    weights = torch.ones(6)
    weights[3] = 0.0
    seen = filmed(
        make_observations, overlap=4.1, train=(0, 2, 3, 4, 5), validation=(1,), weights=weights
    )
    motion = smooth(seen, 4.1)
    with torch.no_grad():
        motion.offsets[[1, 3]] += 5.0
        motion.transl[[1, 3]] += 5.0
    # What lies between counts for the time between: 4.1 / 2 of an exposure overlaps.
    assert max(felt(motion, frame, seen) for frame in (0, 2, 4, 5)) < 1e-6
    continuity(motion, 2, seen).backward()
    assert motion.offsets.grad.flatten(1).abs().sum(1).nonzero().flatten().tolist() == [0, 2, 4]


def test_each_neighbour_counts_as_much_however_often_it_is_compared(make_observations):
    seen = filmed(make_observations, overlap=1.5, train=(0, 2, 3), validation=(1,))
    motion = bent(seen)
    before, after = felt(motion, 0, seen), felt(motion, 3, seen)  # at one instant, at three
    assert abs(before - after) > 0.01
    assert felt(motion, 2, seen) == pytest.approx((before + after) / 2)


def test_a_frame_by_itself_has_no_prior(make_observations):
    seen = filmed(make_observations, train=(2,), validation=(0,))
    motion = created(seen)
    assert motion.priors(2, motion(2), seen) == {}


def test_exposures_are_compared_at_times_that_both_see():
    assert meeting(4.0) == ([0.25, 0.625, 1.0], [0.0, 0.375, 0.75])
    assert meeting(1.0) == meeting(0.3) == meeting(0.0) == ([1.0], [0.0])
    torch.testing.assert_close(
        torch.tensor(meeting(1 + 1e-9)), torch.tensor([[1.0], [0]]).repeat(1, 3)
    )
    for overlap in (1.5, 2.1, 6.1):
        here, there = meeting(overlap)
        times = [(u - 0.5) * overlap for u in here], [1 + (u - 0.5) * overlap for u in there]
        assert times[0] == pytest.approx(times[1])
        assert min(*here, *there) >= 0
        assert max(*here, *there) <= 1


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("pose_network", [None, {"hidden": [8], "rate": 1e-3}])
def test_gradients_are_finite_where_nothing_moves(make_observations, dtype, pose_network):
    still = filmed(make_observations)
    poses = still.poses
    same = dataclasses.replace(
        poses,
        body_pose=torch.zeros_like(poses.body_pose),
        transl=torch.zeros_like(poses.transl),
    )
    still = dataclasses.replace(still, poses=same)
    motion = created(still, start_noise=0.0, pose_network=pose_network).to(dtype)
    here = motion(2)
    assert {value.dtype for value in vars(here).values()} == {dtype}
    prior = continuity(motion, 2, still)
    assert prior == 0
    (here.quats.sum() + here.centre_quats.sum() + here.transl.sum() + prior).backward()
    gradients = [value.grad for value in motion.parameters()]
    assert all(torch.isfinite(gradient).all() for gradient in gradients)
    assert motion.offsets.grad[2].abs().max() > 0


class FeltAndSeen(torch.nn.Module):
    """What a step of fitting makes of a motion."""

    def __init__(self, motion, seen):
        super().__init__()
        self.motion, self.seen = motion, seen

    def forward(self):
        here = self.motion(2)
        return here.quats, here.transl, continuity(self.motion, 2, self.seen)


def test_gradients_are_those_of_finite_differences(seen):
    felt_and_seen = FeltAndSeen(bent(seen), seen)
    names, values = zip(*felt_and_seen.named_parameters(), strict=True)

    def output(*values):
        return torch.func.functional_call(felt_and_seen, dict(zip(names, values, strict=True)), ())

    assert torch.autograd.gradcheck(output, values, fast_mode=True)


@pytest.mark.parametrize("rule", ["overlap", "literal"])
@pytest.mark.parametrize("pose_network", [None, {"hidden": [8, 6], "rate": 1e-3}])
def test_a_saved_motion_goes_on_with_its_network_and_its_rule(seen, tmp_path, rule, pose_network):
    motion = bent(seen, continuity=rule, pose_network=pose_network).float()
    motion.to_artifact(seen.poses.betas, seen.timestamps).save(tmp_path / "motion")
    saved = Motion.load(tmp_path / "motion")
    assert ("pose_network.layers.2.weight" in saved.parameters) == (pose_network is not None)
    again = trajectory_from_artifact(saved)
    assert type(again) is MadMotion
    with torch.no_grad():
        again.offsets[0] += 1.0  # an artifact never changes
    assert torch.equal(saved.parameters["offsets"], motion.offsets)
    assert torch.equal(again(2).quats, motion(2).quats)
    assert torch.equal(again(2).centre_transl, motion(2).centre_transl)
    assert torch.equal(continuity(again, 3, seen), continuity(motion, 3, seen))
    assert again.parameter_groups().keys() == motion.parameter_groups().keys()


def test_overlaps_need_a_known_exposure(make_observations):
    unknown = filmed(make_observations, overlap=None)
    with pytest.raises(ConfigError, match=r"continuity: overlap needs .* take continuity: literal"):
        created(unknown)
    motion = created(unknown, continuity="literal")
    assert torch.isfinite(continuity(motion, 2, unknown))


def test_without_a_network_there_is_no_rate_for_one():
    assert params().learning_rates() == {"poses": 1e-3, "transl": 1e-4, "pose_network": 5e-5}
    assert params(pose_network=None).learning_rates() == {"poses": 1e-3, "transl": 1e-4}
    assert params(priors={"continuity": 0.5}).weights() == {"continuity": 0.5}
    with pytest.raises(ConfigError, match="continuity"):
        params(continuity="smooth")


def rendered(model, rotations, transl, view):
    """An avatar's average over some poses, with gradients."""
    transforms = model.transforms(rotations, transl)
    state = model.condition(rotations[0], 0, transforms[0], view.viewmat)
    return model.render(state, transforms, view, average=True).image


def test_it_explains_a_blurred_picture_by_a_motion(seen, painted, front):
    motion, model, view = created(seen), painted(), front.camera(0)
    swing = torch.zeros(5, 24, 3)
    swing[:, 16, 2] = torch.linspace(-0.5, 0.5, 5)  # radians, of an arm
    given = axis_angle_to_quat(seen.poses.axis_angle[2]).expand(5, -1, -1)
    truth = quat_to_matrix(quat_multiply(given, axis_angle_to_quat(swing)))
    with torch.no_grad():
        frame = rendered(model, truth, seen.poses.transl[2].expand(5, 3), view)
    optimizer = torch.optim.Adam([motion.offsets, motion.transl], lr=0.01)

    def loss():
        here = motion(2)
        return (rendered(model, here.rotations, here.transl, view) - frame).abs().mean()

    def travelled():
        arm = motion(2).quats[:, 16].detach()
        return float(angle(arm[0], arm[-1]))

    first, started = float(loss().detach()), travelled()
    for _ in range(120):
        optimizer.zero_grad()
        loss().backward()
        optimizer.step()
    assert float(loss().detach()) < 0.5 * first
    assert travelled() > 2 * started
