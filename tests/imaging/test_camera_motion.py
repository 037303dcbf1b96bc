import math

import av
import numpy as np
import pytest
import torch

from deblur_avatar.imaging.camera_motion import STILL, background_mask, background_travel
from deblur_avatar.imaging.video_writing import write_video
from tests.imaging.moving_camera import SIZE, filmed, turned

WIDE = np.random.default_rng(0).integers(0, 255, (80, 300, 3)).astype(np.uint8).repeat(2, 1)
NO_ONE = torch.zeros(8, 80, 200, dtype=torch.uint8)


def panned(pixels: int) -> torch.Tensor:
    """A camera that turns over a wide picture."""
    frames = [WIDE[:, step * pixels : step * pixels + 200] for step in range(8)]
    return torch.from_numpy(np.stack(frames))


def test_a_pan_travels_as_far_as_it_goes():
    assert background_travel(panned(3), NO_ONE) == pytest.approx(7 * 3 / 200, rel=0.05)


def test_a_still_camera_does_not_travel_however_the_person_moves():
    frames = panned(0)
    mattes = NO_ONE.clone()
    mattes[:, 10:70, 60:140] = 255
    person = panned(3)[:, 10:70, 60:140]
    frames[:, 10:70, 60:140] = person
    assert background_travel(frames, mattes) == pytest.approx(0, abs=1e-3)


@pytest.mark.parametrize(("degrees", "zoom"), [(3.0, 1.0), (-3.0, 1.0), (0.0, 1.06), (0.0, 0.94)])
def test_a_roll_or_a_zoom_travels_as_far_as_a_corner_of_the_picture(degrees: float, zoom: float):
    frames, mattes, _ = filmed(24, camera=turned(24, degrees, zoom))
    half_diagonal = 0.5 * math.hypot(*SIZE) / SIZE[0]
    true = half_diagonal * max(math.radians(abs(degrees)), abs(1 - zoom))
    assert background_travel(frames, mattes) == pytest.approx(true, rel=0.1)
    assert true > STILL


def test_a_zoom_there_and_back_counts():
    frames, mattes, _ = filmed(12, camera=turned(12, 0, 1.06))
    there_and_back = torch.cat([frames, frames.flip(0)]), torch.cat([mattes, mattes.flip(0)])
    travel = background_travel(*there_and_back)
    assert travel is not None
    assert travel > 2 * STILL


def test_a_logo_that_stands_still_holds_no_camera():
    frames = panned(3)
    frames[:, :, :70] = torch.from_numpy(WIDE[:, :70])  # a third of the picture
    travel = background_travel(frames, NO_ONE)
    assert travel == pytest.approx(7 * 3 / 200, rel=0.1)


def test_a_still_camera_that_is_noisy_and_encoded_does_not_travel(tmp_path):
    frames, mattes, _ = filmed(300, camera=[turned(2)[0]] * 300)
    noise = np.random.default_rng(0).normal(0, 8, frames.shape)
    noisy = (frames.numpy() + noise).round().clip(0, 255).astype(np.uint8)
    path = tmp_path / "still.mp4"
    write_video(path, noisy, 30.0)
    with av.open(str(path)) as video:
        read = np.stack([frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)])
    travel = background_travel(torch.from_numpy(read), mattes)
    assert travel is not None
    assert travel < 0.2 * STILL


def test_an_empty_background_tells_nothing():
    assert (
        background_travel(torch.full((4, 40, 40, 3), 90, dtype=torch.uint8), NO_ONE[:4, :40, :40])
        is None
    )


def test_background_keeps_away_from_the_person():
    matte = torch.zeros(100, 100, dtype=torch.uint8)
    matte[50, 50] = 1
    assert int((~background_mask(matte)).sum()) == 7 * 7
