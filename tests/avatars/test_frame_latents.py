import torch

from deblur_avatar.avatars.frame_latents import FrameLatents


def filled():
    latents = FrameLatents(5, 2)
    with torch.no_grad():
        latents.codes.copy_(torch.arange(10.0).reshape(5, 2))
    return latents


def test_codes_are_nothing_at_first_and_one_a_frame():
    assert not FrameLatents(5, 2).codes.any()
    assert filled()(3).tolist() == [6.0, 7.0]
    assert filled()(99).tolist() == [8.0, 9.0]


def test_untrained_frames_take_after_the_nearest_trained_one():
    latents = filled()
    latents.fill_untrained([3, 0])
    assert latents.codes[:, 0].tolist() == [0.0, 0.0, 6.0, 6.0, 6.0]
