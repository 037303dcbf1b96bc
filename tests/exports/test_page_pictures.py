"""The page draws what the project's rasterizer draws, in a real browser."""

import numpy as np
import pytest
import torch

from deblur_avatar.avatars.render import render_avatar
from deblur_avatar.exports.shown_motion import shown_motions
from deblur_avatar.geometry.cameras import Camera, look_at
from deblur_avatar.imaging.color import srgb_to_linear
from tests.exports.browser import opened, pixels, silent_page

UP = torch.tensor([0.0, 1.0, 0.0])
EYES = {
    "front": (0.3, 0.4, 3.1),
    "behind": (-1.0, 0.0, -2.4),
    "above": (1.2, 2.6, 0.8),
    "so near that Gaussians leave the picture": (0.2, 0.3, 0.8),
}
PERSON = 0.05  # coverage from which a pixel is the person's
DIFFERENT = 40  # dB, below which pictures are not the same


def camera(eye, width=96, height=128) -> Camera:
    K = torch.tensor([[150.0, 0, 47.0], [0, 155.0, 66.0], [0, 0, 1]])
    return Camera(K, look_at(torch.tensor(eye), torch.zeros(3), UP), width, height)


def psnr(a, b, where) -> float:
    return float(-10 * np.log10(np.square(a - b)[where].mean()))


@pytest.fixture(scope="module", params=["srgb", "linear"])
def shown(request, rough, fitted_run, page_exporter, exported, browser):
    """An avatar, its motions and its page, which draws what it is asked for and stays as it is."""
    model = rough(request.param)
    run = fitted_run(model)
    motions = {
        motion.name: motion for motion in shown_motions(run, page_exporter.motions, 30.0, 1.2)
    }
    with silent_page(browser, 800, 600) as page:
        yield model, motions, opened(page, exported(request.param, run))


def test_every_view_is_the_rasterizers(shown):
    model, motions, page = shown
    for name, eye in EYES.items():
        for motion, frame in (("own", 1), ("jumping_jacks", 8)):
            seen, poses = camera(eye), motions[motion].poses
            ours, alpha = render_avatar(model, poses.at([frame]), seen)
            seconds = float(motions[motion].times[frame])
            theirs = pixels(page, seen, motion=motion, seconds=seconds)
            where = alpha[0].numpy() > PERSON
            assert where.mean() > 0.02
            assert psnr(theirs[..., :3], ours[0].numpy(), where) >= 50, (name, motion)
            others, _ = render_avatar(model, poses.at([frame + 2]), seen)
            assert psnr(theirs[..., :3], others[0].numpy(), where) < DIFFERENT


def test_the_shutter_is_the_mean_of_sharp_instants_in_the_averaging_space(shown):
    model, motions, page = shown
    motion, shutter, count = motions["own"], 1 / 30, 7
    u = (torch.arange(count) + 0.5) / count - 0.5
    places = 2 + 60 * shutter * u  # in frames
    poses = motion.poses
    instants = poses.at_times(torch.arange(len(poses.transl)).float(), places)
    seen = camera(EYES["front"])
    ours, alpha = render_avatar(model, instants, seen, average=True)
    sharp, _ = render_avatar(model, poses.at([2]), seen)
    blurred = {"motion": "own", "seconds": float(motion.times[2]), "shutter": shutter}
    theirs = pixels(page, seen, instants=count, **blurred)
    where = alpha[0].numpy() > PERSON
    assert psnr(theirs[..., :3], ours[0].numpy(), where) >= 50
    assert psnr(theirs[..., :3], sharp[0].numpy(), where) < DIFFERENT


def test_a_background_is_blended_in_the_averaging_space(shown):
    model, motions, page = shown
    seen, grey = camera(EYES["front"]), torch.full((3,), 0.5)
    shade = srgb_to_linear(grey) if model.averaging_space == "linear" else grey
    ours, _ = render_avatar(model, motions["own"].poses.at([0]), seen, background=shade)
    theirs = pixels(page, seen, motion="own", seconds=0, background=[0.5] * 3)
    assert psnr(theirs[..., :3], ours[0].numpy(), ...) >= 50
    assert (theirs[..., 3] == 1).all()


def test_what_is_transparent_holds_the_coverage(shown):
    model, motions, page = shown
    seen = camera(EYES["front"])
    _, alpha = render_avatar(model, motions["own"].poses.at([0]), seen)
    theirs = pixels(page, seen, motion="own", seconds=0, background=None)
    np.testing.assert_allclose(theirs[..., 3], alpha[0].numpy(), atol=0.01)


def test_a_joint_turns_what_hangs_on_it(shown):
    model, motions, page = shown
    seen = camera(EYES["front"])
    poses = motions["own"].poses.at([2])
    poses.body_pose[:, 15, 2] += torch.deg2rad(torch.tensor(40.0))  # the left shoulder, about z
    ours, alpha = render_avatar(model, poses, seen)
    seconds = float(motions["own"].times[2])
    theirs = pixels(page, seen, motion="own", seconds=seconds, bends={"16": [0, 0, 40]})
    where = alpha[0].numpy() > PERSON
    assert psnr(theirs[..., :3], ours[0].numpy(), where) >= 50
