import numpy as np
import pytest
import torch

from deblur_avatar.imaging.camera_motion import background_mask, background_travel

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


def test_an_empty_background_tells_nothing():
    assert (
        background_travel(torch.full((4, 40, 40, 3), 90, dtype=torch.uint8), NO_ONE[:4, :40, :40])
        is None
    )


def test_background_keeps_away_from_the_person():
    matte = torch.zeros(100, 100, dtype=torch.uint8)
    matte[50, 50] = 1
    assert int((~background_mask(matte)).sum()) == 7 * 7
