import pytest
import torch

from deblur_avatar.imaging.matting import Plate
from deblur_avatar.imaging.own_colors import ALIKE, AROUND, FEWEST, LimbColors, own_colors
from deblur_avatar.imaging.plate_light import relit

pytestmark = pytest.mark.portable

HEIGHT, WIDTH = 40, 60


def capsule(*values: float) -> torch.Tensor:
    """Two ends: right, down, radius; right, down, radius."""
    return torch.tensor(values, dtype=torch.float32)


def inside(limb: torch.Tensor) -> torch.Tensor:
    """Pixels nearer to one of a thousand balls along the line than its radius."""
    rows, columns = torch.arange(HEIGHT) + 0.5, torch.arange(WIDTH) + 0.5
    places = torch.stack(torch.meshgrid(columns, rows, indexing="xy"), dim=-1)
    balls = limb.view(2, 3)[0].lerp(limb.view(2, 3)[1], torch.linspace(0, 1, 1000)[:, None])
    return (torch.cdist(places.flatten(0, 1), balls[:, :2]) < balls[:, 2]).any(1).view(HEIGHT, -1)


def colors_of(frames: torch.Tensor, limbs: torch.Tensor) -> list[list[float]]:
    return own_colors(frames, limbs, None).colors.tolist()


def shared(picture: torch.Tensor, limb: torch.Tensor, colors: torch.Tensor) -> torch.Tensor:
    """Where a plate has one of these colours near a limb that does not move."""
    plate = Plate(picture, torch.ones(picture.shape[:2], dtype=torch.bool))
    limbs = LimbColors(colors, limb.expand(1, 1, 3, 6), None)
    return torch.from_numpy(limbs.shared_with(0, plate))


@pytest.mark.parametrize(
    "limb",
    [
        capsule(10, 10, 4, 45, 30, 2),
        capsule(20, 35, 3, 20, 5, 3),
        capsule(30, 20, 5, 30, 20, 5),  # a ball
        capsule(-5, -3, 6, 20, 12, 3),  # partly outside
        capsule(55, 35, 3, 80, 60, 8),
    ],
)
def test_pixels_of_a_limb_are_those_of_balls_along_it(limb: torch.Tensor):
    black = torch.zeros(HEIGHT, WIDTH, 3, dtype=torch.uint8)
    thin = limb / torch.tensor([1, 1, AROUND, 1, 1, AROUND])
    found = shared(black, thin, torch.zeros(1, 3))
    wanted = inside(limb)
    # Radii between two ends are those across the line, of balls those from their middle.
    assert (found ^ wanted).sum() <= 0.06 * wanted.sum()
    assert wanted.any()


def test_colours_are_of_what_is_covered_at_all_instants():
    frames = torch.zeros(2, HEIGHT, WIDTH, 3, dtype=torch.uint8)
    frames[:, :, 20:30] = torch.tensor([200, 100, 50], dtype=torch.uint8)  # where both are
    moved = torch.stack([capsule(x, 10, 6, x, 30, 6) for x in (22.0, 25.0, 28.0)])
    limbs = moved[None, None].repeat(len(frames), 1, 1, 1)
    assert colors_of(frames, limbs) == [[200, 100, 50]]
    # The first instant alone covers as much that is black.
    alone = colors_of(frames, limbs[:, :, :1] - torch.tensor([6.0, 0, 0, 6, 0, 0]))
    assert alone == [[0, 0, 0]]


def test_what_some_instants_alone_cover_has_no_say():
    moved = torch.stack([capsule(x, 5, 5, x + 25, 35, 5) for x in (14.0, 20.0, 26.0)])
    always = torch.stack([inside(limb) for limb in moved]).all(0)
    assert 10 < always.sum() < 0.3 * inside(moved[1]).sum()
    frames = torch.where(always[..., None], 200, 10).to(torch.uint8).repeat(9, 1, 1, 3)
    assert colors_of(frames, moved[None, None].repeat(len(frames), 1, 1, 1)) == [[200, 200, 200]]


def test_the_median_of_all_frames_is_a_limb_s_colour():
    frames = torch.zeros(5, HEIGHT, WIDTH, 3, dtype=torch.uint8)
    frames[:] = torch.tensor([10, 20, 30, 40, 250], dtype=torch.uint8)[:, None, None, None]
    limbs = capsule(20, 10, 4, 20, 30, 4).expand(5, 1, 3, 6)
    assert colors_of(frames, limbs) == [[30, 30, 30]]


@pytest.mark.parametrize("unknown", ["jumps", "outside", "unsure"])
def test_a_limb_that_covers_no_pixel_for_so_long_has_no_colour(unknown: str):
    frames = torch.full((2, HEIGHT, WIDTH, 3), 90, dtype=torch.uint8)
    places = {"jumps": (5.0, 25.0, 45.0), "outside": (-30.0,) * 3, "unsure": (25.0,) * 3}[unknown]
    moved = torch.stack([capsule(x, 10, 4, x, 30, 4) for x in places])
    limbs = moved[None, None].repeat(len(frames), 1, 1, 1)
    if unknown == "unsure":
        limbs[:, :, 0, 1] = torch.nan
    found = own_colors(frames, limbs, None)
    assert found.colors.isnan().all()
    assert not found.shared_with(0, Plate(frames[0], frames[0, ..., 0] > 0)).any()


def test_fewer_pixels_than_tell_a_colour_tell_none():
    frames = torch.full((1, HEIGHT, WIDTH, 3), 90, dtype=torch.uint8)
    small, large = capsule(20, 15, 3, 20, 20, 3), capsule(20, 15, 6, 20, 20, 6)
    assert inside(small).sum() < FEWEST < inside(large).sum()
    assert torch.tensor(colors_of(frames, small.expand(1, 1, 3, 6))).isnan().all()
    assert colors_of(frames, large.expand(1, 1, 3, 6)) == [[90, 90, 90]]


def test_colours_are_compared_in_each_frame_s_light():
    stops = torch.tensor([[-1.5, -1.0, -1.2], [0, 0, 0], [0.9, 1.2, 1.0]])
    wall = torch.full((HEIGHT, WIDTH, 3), 110, dtype=torch.uint8)
    trousers = torch.full((HEIGHT, WIDTH, 3), 115, dtype=torch.uint8)
    limb = capsule(20, 10, 5, 20, 30, 5)
    frames = torch.stack([relit(trousers, stop) for stop in stops])
    limbs = own_colors(frames, limb.expand(3, 1, 3, 6), stops)
    assert (limbs.colors - 115).abs().max() <= 1
    for index, stop in enumerate(stops):
        lit = Plate(relit(wall, stop), torch.ones(HEIGHT, WIDTH, dtype=torch.bool))
        assert limbs.shared_with(index, lit)[20, 20]
    dark = Plate(relit(wall, stops[0]), torch.ones(HEIGHT, WIDTH, dtype=torch.bool))
    assert not limbs.shared_with(2, dark).any()


def test_a_picture_is_like_a_limb_where_it_has_its_colour_and_the_limb_is():
    picture = torch.full((HEIGHT, WIDTH, 3), 100, dtype=torch.uint8)
    picture[20:] = 100 + ALIKE
    limb = capsule(30, 5, 4, 30, 35, 4)
    found = shared(picture, limb, torch.full((1, 3), 101.0))
    assert found[10, 30]
    assert found[10, 30 + int(4 * AROUND) - 2]
    assert not found[10, 30 + int(4 * AROUND) + 2]
    assert found[30, 30]  # one code nearer than `ALIKE`
    assert not shared(picture, limb, torch.full((1, 3), 100.0))[30, 30]
    one_colour = torch.tensor([[100.0, 100.0, 100.0 - ALIKE]])
    assert not shared(picture, limb, one_colour).any()
