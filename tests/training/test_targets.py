import dataclasses

import torch

from deblur_avatar.training.targets import target_of


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
