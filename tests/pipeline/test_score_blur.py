import dataclasses

import pytest

from deblur_avatar.pipeline.blur import blur
from deblur_avatar.pipeline.score_blur import score_blur
from tests.pipeline.moving_ball import PLAIN, changed, make_clip


def scores(clip, params):
    return score_blur(clip, blur(clip, params), params)


def test_made_blur_is_close_to_true_blur_and_interpolation_beats_a_plain_mean():
    measured = scores(make_clip(), PLAIN)
    assert measured["blur"]["psnr"] > 45
    assert measured["interpolation"]["psnr"] > measured["interpolation"]["psnr_plain"] + 5
    assert measured["frames"] == {"clip": 12, "kept": 10, "dropped": 2, "held_out": 2}
    assert measured["exposure_ms"] == pytest.approx(1e3 * 9 / 240)


def test_true_blur_is_said_to_be_true():
    assert scores(make_clip(), changed(PLAIN, frames="true"))["source"] == "true"


@pytest.mark.parametrize("window", [1, 7])
def test_true_blur_of_another_window_measures_nothing(window):
    assert scores(make_clip(), changed(PLAIN, window=window))["blur"] is None


def test_of_a_clip_that_is_blurred_already_frames_are_counted_alone():
    clip = dataclasses.replace(make_clip(), blurred=True, exposure=0.02, averaging_space="linear")
    counts = {"clip": 12, "kept": 12, "dropped": 0, "held_out": 3}
    assert scores(clip, PLAIN) == {"frames": counts}
