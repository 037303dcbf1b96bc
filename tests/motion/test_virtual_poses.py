import dataclasses

import pytest
import torch

from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.config.reading import parse
from deblur_avatar.motion.clip import REFERENCE_HEIGHT, ClipMotion, ClipParams
from deblur_avatar.motion.frame import FixedMotion, FrameMotion
from deblur_avatar.motion.trajectory import instants
from deblur_avatar.motion.virtual_poses import farthest_travel


def along(seen: Observations, exposure: float = 1 / 60) -> ClipMotion:
    u = instants(5, "midpoints")
    return ClipMotion.near(seen.poses, u, seen.timestamps, exposure, 1 / 60, 0.0)


@pytest.fixture
def sampled(tiny_content):
    """A trajectory along the poses whose samples have been chosen."""

    def make(seen: Observations, **changes) -> ClipMotion:
        section = tiny_content["methods"]["lean"]["trajectory"]["motion"]
        section |= {"knot_frames": 1.0, "smoothness": 0.0}
        params = parse(ClipParams, section | changes, "motion")
        motion = ClipMotion.create(seen, params, torch.Generator())
        motion.choose_samples(seen)
        return motion

    return make


def test_travel_is_that_of_the_joint_that_gets_farthest(make_observations):
    # The left hand is about 0.5 m from the shoulder that turns by 12 degrees a frame; 1.6 * 24 px
    # at 4 m make 9.6 px a metre.
    seen = make_observations(frames=9, degrees=12.0)
    travel = farthest_travel(along(seen), seen)
    hand = 9.6 * 0.209 * 0.5
    assert travel.shape == (9,)
    assert 0.7 * hand < float(travel[4]) < 1.4 * hand


def test_travel_grows_with_the_exposure_and_is_nothing_for_a_still_body(make_observations):
    seen = make_observations(frames=9, degrees=12.0)
    short, long = (farthest_travel(along(seen, share / 60), seen)[4] for share in (0.5, 1.0))
    assert float(long) == pytest.approx(2 * float(short), rel=0.05)
    still = FixedMotion(seen.poses)
    assert farthest_travel(still, seen).tolist() == [0.0] * 9


def test_a_joint_that_goes_there_and_back_has_travelled(make_observations):
    seen = make_observations(frames=9, degrees=0.0)
    motion = along(seen)
    knots = motion.transl.data
    knots[:, 1] += 0.1 * (torch.arange(len(knots)) % 2)
    assert float(farthest_travel(motion, seen)[4]) > 0


def test_samples_follow_travel_between_one_and_the_most(make_observations, sampled):
    seen = make_observations(frames=9, degrees=12.0)
    height = seen.frames.shape[1]
    step = float(farthest_travel(along(seen), seen)[4]) / 2.5 * REFERENCE_HEIGHT / height
    assert int(sampled(seen, pixels_per_pose=step, virtual_poses=9).num_samples(9)[4]) == 3
    assert int(sampled(seen, pixels_per_pose=step, virtual_poses=2).num_samples(9).max()) == 2
    assert sampled(seen, pixels_per_pose=1e6, virtual_poses=9).num_samples(9).tolist() == [1] * 9


def test_pictures_of_any_size_take_as_many_samples(make_observations, sampled):
    seen = make_observations(frames=9, degrees=12.0)
    larger = dataclasses.replace(
        seen,
        frames=seen.frames.repeat_interleave(3, 1).repeat_interleave(3, 2),
        mattes=seen.mattes.repeat_interleave(3, 1).repeat_interleave(3, 2),
        cameras=dataclasses.replace(
            seen.cameras,
            Ks=torch.tensor([3.0, 3, 1])[:, None] * seen.cameras.Ks,
            sizes=3 * seen.cameras.sizes,
        ),
    )
    counts = [
        sampled(one, pixels_per_pose=2.0, virtual_poses=9).num_samples(9).tolist()
        for one in (seen, larger)
    ]
    assert counts[0] == counts[1]
    assert 1 < max(counts[0]) < 9


def test_without_a_step_every_exposure_has_all_poses(make_observations, sampled):
    seen = make_observations(frames=9, degrees=12.0)
    motion = sampled(seen, pixels_per_pose=0.0, virtual_poses=5)
    assert motion.num_samples(9).tolist() == [5] * 9
    frame = FrameMotion(seen.poses)
    frame.choose_samples(seen)
    assert frame.num_samples(9).tolist() == [1] * 9


def test_sharp_frames_are_one_instant_of_the_trajectory_however_fast_it_is(
    sampled, make_observations
):
    """What an oracle with the clip's trajectory sees: a shutter that does not open."""
    seen = dataclasses.replace(make_observations(frames=9, degrees=40.0), exposure=0.0)
    motion = sampled(seen, pixels_per_pose=0.05)
    assert motion.num_samples(9).tolist() == [1] * 9
    assert (
        sampled(dataclasses.replace(seen, exposure=1 / 60), pixels_per_pose=0.05)
        .num_samples(9)
        .max()
        > 1
    )
    instant = motion(4)
    assert len(instant.quats) == 1
    assert torch.equal(instant.quats[0], instant.centre_quats)
    assert torch.equal(instant.transl[0], instant.centre_transl)
