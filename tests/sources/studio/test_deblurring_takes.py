import pytest
import torch

from deblur_avatar.sources.studio.deblurring_takes import SPACES, TakesParams, film_take, film_takes

PARAMS = TakesParams(
    frames=3, fps=60.0, windows=(1, 9, 17), image_size=24, samples_per_axis=1, fields=(1.5, 2.2),
    betas_deviation=0.5,
    unfitted_body={"shape_mm": 8.0, "weight_rounds": 2, "swing": 1.0, "hair_mm": 25.0},
    noise={"shot": 4e-4, "read": 0.004},
)  # fmt: skip


@pytest.fixture(scope="module")
def clips(body):
    return film_takes(PARAMS, body, [5, 6])


def test_there_is_a_blurred_frame_a_window_for_each_sharp_one(clips):
    assert clips.sharp.shape == (2, 3, 24, 24, 3)
    assert clips.blurred.shape == (2, 3, 3, 24, 24, 3)
    assert clips.windows == (1, 9, 17)
    assert clips.averaging_spaces == SPACES
    assert int(clips.sharp_mattes.amax()) == 255


def test_a_window_of_one_instant_is_the_sharp_frame(clips):
    """So sharp and blurred frames are of the same instants; the second take is noisy."""
    assert torch.equal(clips.blurred[0, 0], clips.sharp[0])
    assert torch.equal(clips.blurred_mattes[:, 0], clips.sharp_mattes)
    noise = clips.blurred[1, 0].float() - clips.sharp[1].float()
    assert 0 < float(noise.abs().mean()) < 4
    assert not clips.blurred[clips.blurred_mattes == 0].any()


def test_longer_windows_blur_more(clips):
    away = (clips.blurred_mattes.float() - clips.sharp_mattes[:, None].float()).abs()
    errors = away.mean((0, 2, 3, 4))
    assert float(errors[0]) == 0 < float(errors[1]) < float(errors[2])


def test_a_take_is_its_seed_s_whatever_else_is_filmed(body, clips):
    alone = film_take(PARAMS, body, SPACES[1], torch.Generator().manual_seed(6))
    assert torch.equal(alone.sharp[..., :3], clips.sharp[1])
    assert torch.equal(alone.blurred[..., :3], clips.blurred[1])
    assert not torch.equal(clips.sharp[0], clips.sharp[1])
