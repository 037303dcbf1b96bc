import dataclasses
import logging
import math

import pytest
import torch

from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.avatars.avatar import AvatarModel
from deblur_avatar.avatars.render import render_avatar
from deblur_avatar.imaging.exposure import GUESS_STD
from deblur_avatar.motion.clip import ClipMotion
from deblur_avatar.motion.shutter_certainty import shutter_std
from deblur_avatar.motion.trajectory import instants
from deblur_avatar.pipeline.trajectory import exposure_renderer

pytestmark = pytest.mark.portable

FRAMES, TRUE = 16, 2 / 60
DRAW = 1 / 255  # what a pixel is off by


def along(seen: Observations, shutter: float) -> ClipMotion:
    """A trajectory that began at the true shutter, and was fitted to this one."""
    u = instants(5, "midpoints")
    motion = ClipMotion.near(
        seen.poses, u, seen.timestamps, TRUE, 1 / 60, 0.0, estimate_shutter=True
    )
    with torch.no_grad():
        motion.log_shutter.fill_(math.log(shutter / TRUE))
    motion.remember_halfway()
    return motion


def told_by_frames(model: AvatarModel, motion: ClipMotion, seen: Observations) -> float:
    render = exposure_renderer(model, seen)

    def exposed(frame: int, log_shutter: float) -> torch.Tensor:
        return render(frame, motion.with_shutter(frame, log_shutter))

    return shutter_std(exposed, motion.log_shutter, seen)


@pytest.fixture
def filmed(painted, make_observations):
    def film(degrees: float, noise: float = DRAW) -> tuple[AvatarModel, Observations]:
        """A model that explains the frames, but for noise, if the shutter is the true one."""
        model = painted(frames=FRAMES)
        seen = make_observations(frames=FRAMES, degrees=degrees)
        if degrees == 0:
            seen = dataclasses.replace(seen, poses=seen.poses.at([0] * FRAMES))
        seen = dataclasses.replace(seen, train=tuple(range(FRAMES)), validation=())
        motion = along(seen, TRUE).to_artifact(model.betas.detach(), seen.timestamps)
        frames = []
        for index in range(FRAMES):
            exposure = Poses(
                betas=seen.poses.betas,
                global_orient=motion.global_orient[index],
                body_pose=motion.body_pose[index],
                transl=motion.transl[index],
            )
            image, _ = render_avatar(model, exposure, seen.camera, frame=index, average=True)
            frames.append(image[0])
        generator = torch.Generator().manual_seed(0)
        pictures = torch.stack(frames)
        pictures = pictures + noise * torch.randn(pictures.shape, generator=generator)
        codes = (pictures.clamp(0, 1) * 255).round().to(torch.uint8)
        return model, dataclasses.replace(seen, frames=codes, exposure=TRUE)

    return film


def test_fast_motion_tells_the_shutter_better_than_slow(filmed):
    told = []
    for degrees in (12.0, 3.0):
        model, seen = filmed(degrees)
        told.append(told_by_frames(model, along(seen, TRUE), seen))
    assert 0 < told[0] < 0.1
    assert told[1] > 2 * told[0]


def test_noisier_frames_tell_less(filmed):
    model, seen = filmed(12.0)
    quiet = told_by_frames(model, along(seen, TRUE), seen)
    model, seen = filmed(12.0, noise=8 * DRAW)
    assert told_by_frames(model, along(seen, TRUE), seen) > 3 * quiet


def test_a_shutter_that_frames_pull_away_from_is_less_certain(filmed):
    model, seen = filmed(12.0)
    right, wrong = (told_by_frames(model, along(seen, s * TRUE), seen) for s in (1.0, 0.7))
    assert wrong > 2 * right


def test_the_motion_is_left_as_it_was(filmed):
    model, seen = filmed(12.0)
    motion = along(seen, 1.3 * TRUE)
    before = {name: value.clone() for name, value in motion.state_dict().items()}
    told_by_frames(model, motion, seen)
    assert all(torch.equal(value, before[name]) for name, value in motion.state_dict().items())


def test_where_nothing_moves_the_guess_stands_and_that_is_said(filmed, caplog):
    model, seen = filmed(0.0)
    motion = along(seen, 1.5 * TRUE)
    assert told_by_frames(model, motion, seen) > GUESS_STD
    with caplog.at_level(logging.INFO, logger="deblur_avatar"):
        found = motion.settle(seen, exposure_renderer(model, seen))
    assert found["shutter_from"] == "guess"
    assert found["shutter_s"] == pytest.approx(TRUE, rel=1e-4)
    assert found["shutter_std_s"] == pytest.approx(TRUE * math.log(2), rel=1e-4)
    closer = dataclasses.replace(seen, exposure_std=0.1)  # who guessed it says how well
    found = motion.settle(closer, exposure_renderer(model, closer))
    assert found["shutter_std_s"] == pytest.approx(TRUE * 0.1, rel=1e-4)
    assert "nothing moved enough to tell: the guess stands" in caplog.text


def test_a_shutter_that_still_moved_is_less_certain(filmed):
    model, seen = filmed(12.0)
    settled, moving = along(seen, TRUE), along(seen, TRUE)
    assert moving.halfway is not None
    moving.halfway.sub_(0.2)
    still, drifted = (
        motion.settle(seen, exposure_renderer(model, seen)) for motion in (settled, moving)
    )
    assert still["shutter_from"] == drifted["shutter_from"] == "frames"
    assert still["shutter_std_s"] < 0.1 * TRUE
    # With the guess, which is good to a factor of two: (0.2^-2 + 0.69^-2)^-0.5 = 0.19.
    assert drifted["shutter_std_s"] == pytest.approx(0.19 * TRUE, rel=0.05)


@pytest.mark.parametrize("times", [1.1, 1.2, 1.25, 1.3, 1.45])
def test_a_shutter_that_ends_at_its_bound_is_said_to(filmed, caplog, times):
    model, seen = filmed(12.0)
    within, beyond = along(seen, TRUE), along(seen, 3 * TRUE)
    with caplog.at_level(logging.INFO, logger="deblur_avatar"):
        for motion, at_bound in ((within, False), (beyond, True)):
            caplog.clear()
            motion._max_log_shutter = math.log(times)
            motion.keep_possible()
            found = motion.settle(seen, exposure_renderer(model, seen))
            assert found["shutter_from"] == "frames"
            assert found["shutter_s"] == pytest.approx((times if at_bound else 1) * TRUE, rel=1e-4)
            assert ("as long as frames are apart" in caplog.text) == at_bound


def test_a_single_frame_tells_nothing(filmed):
    model, seen = filmed(12.0)
    seen = dataclasses.replace(seen, train=(5,))
    assert told_by_frames(model, along(seen, TRUE), seen) == math.inf
