import math

import pytest
import torch

from deblur_avatar.training.exposure_gains import ExposureGains
from deblur_avatar.training.targets import Target

CPU = torch.device("cpu")


def seen(brightness: float) -> Target:
    image = torch.full((4, 4, 3), brightness)
    image[0] = 0.9  # background: outside the matte, it says nothing
    matte = torch.ones(4, 4)
    matte[0] = 0
    return Target(image, matte, None, (0, 0, 4, 4), 1.0)


def visited(
    brightness: list[float], times: int = 2, averaging_space: str = "srgb"
) -> ExposureGains:
    gains = ExposureGains(len(brightness) + 1, averaging_space, CPU)
    for _ in range(times):
        for frame, value in enumerate(brightness):
            gains.observe(frame, torch.full((4, 4, 3), 0.4), seen(value))
    return gains


def test_a_frame_twice_as_bright_as_another_has_twice_its_gain_and_one_is_between():
    gains = visited([0.3, 0.6])
    first, second = (float(gains.of(frame)) for frame in (0, 1))
    assert second == pytest.approx(2 * first, rel=1e-4)
    assert math.log(first) + math.log(second) == pytest.approx(0, abs=1e-5)


def test_brightness_that_all_frames_share_is_the_avatars():
    gains = visited([0.6, 0.6, 0.6])
    assert [float(gains.of(frame)) for frame in range(3)] == pytest.approx([1, 1, 1])


def test_frames_that_were_seen_once_or_never_have_no_gain():
    assert float(visited([0.3, 0.6]).of(2)) == 1
    assert float(visited([0.3, 0.6], times=1).of(1)) == 1


def test_light_is_compared_in_the_space_in_which_it_is_averaged():
    gains = visited([0.5, 1.0], averaging_space="linear")
    # sRGB 0.5 is linear 0.2140.
    assert float(gains.of(1) / gains.of(0)) == pytest.approx(1 / 0.2140, rel=1e-3)


def test_a_frame_has_at_most_two_stops_more_than_the_model():
    gains = visited([1e-5, 0.4])
    assert float(gains.of(1) / gains.of(0)) == pytest.approx(math.exp(1.4), rel=1e-4)


def test_what_was_found_is_handed_on():
    gains, again = visited([0.3, 0.6]), ExposureGains(3, "srgb", CPU)
    again.restore(gains.state())
    assert torch.equal(again.of(1), gains.of(1))
