import dataclasses

import pytest
import torch

from deblur_avatar.training import targets
from deblur_avatar.training.targets import BOX_MARGIN, Targets, target_of

CPU = torch.device("cpu")


def test_colours_that_mean_nothing_are_not_compared(observations):
    comparable = torch.full_like(observations.mattes, 255)
    comparable[:, :, : comparable.shape[2] // 2] = 0
    other = observations.frames.clone()
    other[comparable == 0] = 255 - other[comparable == 0]
    masked = [
        dataclasses.replace(observations, frames=frames, comparable=comparable)
        for frames in (observations.frames, other)
    ]
    first, second = (target_of(seen, 0, torch.device("cpu")) for seen in masked)
    assert torch.equal(first.image, second.image)
    assert torch.equal(first.matte, target_of(observations, 0, torch.device("cpu")).matte)
    render = torch.ones_like(first.image)
    assert first.comparable_part(render)[:, : comparable.shape[2] // 2].max() == 0
    assert first.comparable_part(render)[:, comparable.shape[2] // 2 :].min() == 1


def test_a_smaller_frame_is_the_area_average_of_light(observations):
    frames = observations.frames.clone()
    frames[:, ::2] = 0
    frames[:, 1::2] = 255
    for space, grey in (("srgb", 0.5), ("linear", 0.7354)):  # half the light of white
        seen = dataclasses.replace(observations, frames=frames, averaging_space=space)
        small = Targets(seen, 0.5, CPU)[0]
        torch.testing.assert_close(
            small.image, torch.full_like(small.image, grey), atol=1e-4, rtol=0
        )
        whole = Targets(seen, 1.0, CPU)[0]
        assert small.image.shape[0] == whole.image.shape[0] // 2
        assert float(small.matte.mean()) == pytest.approx(float(whole.matte.mean()), abs=1e-6)


@pytest.mark.parametrize("frames", [1, "each"])
def test_a_background_is_averaged_as_light_is_and_put_behind_renders(observations, frames):
    count = len(observations.frames) if frames == "each" else 1
    pictures = torch.zeros(count, *observations.frames.shape[1:], dtype=torch.uint8)
    pictures[:, ::2] = 255
    pictures[0] = pictures[0].flip(0)  # of its own, where each frame has one
    seen = dataclasses.replace(observations, backgrounds=pictures, averaging_space="linear")
    small, whole = (Targets(seen, share, CPU)[0] for share in (0.5, 1.0))
    assert small.background is not None
    assert whole.background is not None
    torch.testing.assert_close(small.background, torch.full_like(small.background, 0.5))
    assert torch.equal(whole.background[1::2], torch.ones_like(whole.background[1::2]))
    assert torch.equal(Targets(seen, 1.0, CPU)[1].background, (pictures[-1] > 0).float())
    light, alpha = torch.full_like(whole.image, 0.1), torch.full_like(whole.matte, 0.75)
    expected = torch.full_like(light[1::2], 0.35)
    torch.testing.assert_close(whole.behind(light, alpha)[1::2], expected)
    assert torch.equal(Targets(observations, 1.0, CPU)[0].behind(light, alpha), light)


def test_a_smaller_pixel_is_compared_only_if_all_that_it_averages_may_be(observations):
    comparable = torch.full_like(observations.mattes, 255)
    comparable[:, 3, 5] = 0
    seen = dataclasses.replace(observations, comparable=comparable)
    small = Targets(seen, 0.5, CPU)[0]
    assert small.comparable is not None
    left_out = (small.comparable == 0).nonzero().tolist()
    assert left_out == [[1, 2]]
    assert small.image[1, 2].max() == 0


def test_the_camera_of_smaller_frames_sees_the_same_person(observations):
    whole, small = (Targets(observations, share, CPU).camera for share in (1.0, 0.5))
    assert (small.width, small.height, small.binning) == (whole.width // 2, whole.height // 2, 2)
    point = torch.tensor([0.3, -0.2, 1.0])
    assert torch.allclose((whole.K @ point)[:2] / 2, (small.K @ point)[:2])


def test_the_box_holds_the_person_at_every_size(observations):
    for share in (1.0, 0.5):
        target = Targets(observations, share, CPU)[0]
        left, top, right, bottom = target.box
        outside = target.matte.clone()
        outside[top:bottom, left:right] = 0
        assert outside.max() == 0
        rows = torch.nonzero(target.matte.amax(1)).flatten()
        assert top == max(int(rows.min()) - BOX_MARGIN, 0)


def test_full_frames_are_kept_on_a_gpu_where_they_are_not_too_many(observations, monkeypatch):
    elsewhere = torch.device("meta")
    few, here = Targets(observations, 1.0, elsewhere), Targets(observations, 1.0, CPU)
    assert few[0] is few[0]
    assert here[0] is not here[0]
    monkeypatch.setattr(targets, "KEPT_ON_A_GPU", 8 * observations.mattes.numel() - 1)
    many = Targets(observations, 1.0, elsewhere)
    assert many[0] is not many[0]
