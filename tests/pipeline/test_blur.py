import dataclasses

import cv2
import pytest
import torch

from deblur_avatar.errors import ConfigError
from deblur_avatar.imaging.exposure import frames_before
from deblur_avatar.pipeline.blur import blur
from tests.pipeline.moving_ball import PLAIN, changed, make_clip

pytestmark = pytest.mark.portable


def test_frames_are_the_mean_of_the_light_that_fell_while_the_shutter_was_open():
    clip = make_clip()
    blurry = blur(clip, PLAIN)
    assert blurry.frame_indices == tuple(range(1, 11))
    error = (blurry.frames[0].int() - clip.true_blur_srgb.int()).abs()
    assert error.max() <= 6
    assert (blurry.mattes[0].int() - clip.true_blur_mattes.int()).abs().max() <= 6
    sharp_error = (blurry.sharp_frames.int() - clip.true_blur_srgb.int()).abs()
    assert sharp_error.max() > 3 * error.max()


def test_all_that_belongs_to_a_frame_stays_with_it():
    clip = make_clip()
    blurry = blur(clip, PLAIN)
    kept = list(blurry.frame_indices)
    assert torch.equal(blurry.timestamps, clip.timestamps[kept])
    assert torch.equal(blurry.sharp_frames, clip.frames[0, kept])
    assert torch.equal(blurry.sharp_mattes, clip.mattes[0, kept])
    assert blurry.initial.transl[:, 0].tolist() == kept
    assert blurry.frame_indices[blurry.held_out_from] == clip.held_out_from
    assert blurry.exposure == pytest.approx(9 / 240)
    assert blurry.exact is None


def test_training_frames_can_be_told_from_those_that_see_the_held_out_part():
    blurry = blur(make_clip(), PLAIN)
    begin = float(blurry.timestamps[blurry.held_out_from])
    before = frames_before(blurry.timestamps, blurry.exposure, begin)
    # Frame 8's window ends one quarter after frame 9 began; frame 7's just touches frame 8.
    assert [blurry.frame_indices[index] for index in before] == [1, 2, 3, 4, 5, 6, 7]


def test_every_recorded_camera_is_blurred_alike():
    blurry = blur(make_clip(recorded=(0, 1)), PLAIN)
    single = blur(make_clip(), PLAIN)
    assert torch.equal(blurry.frames[0], single.frames[0])
    assert torch.equal(blurry.frames[1], single.frames[0])


def test_linear_light_is_brighter_where_bright_and_dark_mix():
    clip = make_clip()
    in_srgb = blur(clip, PLAIN)
    in_linear = blur(clip, changed(PLAIN, averaging_space="linear"))
    assert in_linear.averaging_space == "linear"
    assert in_linear.frames.double().mean() > in_srgb.frames.double().mean() + 0.2
    assert torch.equal(in_linear.mattes, in_srgb.mattes)


def test_the_physically_true_blur_is_taken_as_it_is():
    clip = make_clip()
    blurry = blur(clip, changed(PLAIN, frames="true"))
    assert torch.equal(blurry.frames[0], clip.true_blur_srgb)
    assert torch.equal(blurry.mattes[0], clip.true_blur_mattes)


def test_a_window_of_one_gives_the_sharp_frames():
    clip = make_clip()
    assert torch.equal(blur(clip, changed(PLAIN, window=1)).frames, clip.frames)


def test_a_clip_that_is_blurred_already_passes_through():
    clip = dataclasses.replace(make_clip(), blurred=True, exposure=0.02, averaging_space="linear")
    blurry = blur(clip, PLAIN)
    assert torch.equal(blurry.frames, clip.frames)
    assert blurry.exposure == 0.02
    assert blurry.averaging_space == "linear"
    assert blurry.sharp_frames is None


@pytest.mark.parametrize(
    ("values", "complaint"),
    [
        ({"window": 8}, "a window centred on a frame is odd, got 8"),
        ({"window": 45}, "45 sub-frames, 4 a frame, leave no training frame of a clip of 12"),
        ({"frames": "true", "averaging_space": "linear"}, "no true blur in linear light"),
        ({"frames": "true", "window": 11}, "true blur is of 37.50 ms, .* ask for 45.83 ms"),
        ({"frames": "true", "window": 7}, "true blur is of 37.50 ms, .* ask for 29.17 ms"),
    ],
)
def test_what_cannot_be_blurred_is_refused(values, complaint):
    with pytest.raises(ConfigError, match=complaint):
        blur(make_clip(), changed(PLAIN, **values))


def test_true_blur_of_several_cameras_is_refused():
    with pytest.raises(ConfigError, match="one recorded camera"):
        blur(make_clip(recorded=(0, 1)), changed(PLAIN, frames="true"))


def test_frames_that_are_not_evenly_spaced_are_refused():
    clip = make_clip()
    uneven = clip.timestamps.clone()
    uneven[5:] += 0.01
    with pytest.raises(ConfigError, match="evenly spaced frames, but intervals range from"):
        blur(dataclasses.replace(clip, timestamps=uneven), PLAIN)


def test_the_result_does_not_depend_on_how_many_threads_opencv_uses():
    before = cv2.getNumThreads()
    try:
        cv2.setNumThreads(1)
        one = blur(make_clip(), PLAIN)
        cv2.setNumThreads(2)
        two = blur(make_clip(), PLAIN)
    finally:
        cv2.setNumThreads(before)
    assert torch.equal(one.frames, two.frames)
