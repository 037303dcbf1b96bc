"""Who is found counts where her true box is."""

import pytest
import torch

from benchmarks.small_people import HEIGHTS, TALL, camera_for, in_place
from deblur_avatar.body_estimation.landmarks import COUNT, Landmarks
from deblur_avatar.geometry.cameras import project


def seen(middle, visibility=0.9, found=True):
    points = torch.tensor(middle) + torch.linspace(-10, 10, COUNT)[:, None].expand(-1, 2)
    return Landmarks(
        torch.tensor([found]), points[None], torch.full((1, COUNT), visibility),
        torch.zeros(1, 4, 4, dtype=torch.uint8),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("person", "there"),
    [
        (seen((50.0, 60.0)), True),
        (seen((58.0, 60.0)), True),
        (seen((62.0, 60.0)), False),
        (seen((50.0, 60.0), visibility=0.3), False),
        (seen((50.0, 60.0), found=False), False),
    ],
    ids=["there", "beside by less than half", "beside by more", "unsure", "not found"],
)
def test_who_is_found_counts_where_she_is(person, there):
    assert in_place(person, torch.tensor([[40.0, 50.0, 60.0, 70.0]])).tolist() == [there]


@pytest.mark.parametrize("height", HEIGHTS)
def test_who_stands_is_about_as_tall_in_the_picture(height):
    cameras = camera_for(height)
    line = torch.tensor([[0.0, 0.0, 0.0], [0.0, TALL, 0.0]])
    pixels, _ = project(line, cameras.Ks[0], cameras.viewmats[0])
    assert float((pixels[0] - pixels[1]).norm()) == pytest.approx(height, rel=0.15)
